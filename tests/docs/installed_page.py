"""Install the package that a page describes: its modules and its metadata."""

from __future__ import annotations

import importlib
import re
import sys
import tomllib
from pathlib import Path

import pytest

_MODULE = re.compile(r"^`(\w+\.py)`\n\n```python\n(.*?)```", re.MULTILINE | re.DOTALL)


def install_page(page: str, folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Write the modules and entry points of a page's package into a folder on the path of imports."""
    project = next(one for one in map(tomllib.loads, re.findall(r"```toml\n(.*?)```", page, re.S)) if "project" in one)
    modules = dict(_MODULE.findall(page))
    assert {f"{name}.py" for name in project["tool"]["setuptools"]["py-modules"]} == set(modules)
    name, version = project["project"]["name"], project["project"]["version"]
    metadata = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    metadata.mkdir(parents=True)
    for file, text in modules.items():
        (folder / file).write_text(text, encoding="utf-8")
        patch.delitem(sys.modules, file.removesuffix(".py"), raising=False)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    groups = project["project"]["entry-points"]
    lines = [f"[{group}]\n" + "\n".join(f"{k} = {v}" for k, v in named.items()) for group, named in groups.items()]
    (metadata / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")
    patch.syspath_prepend(str(folder))
    importlib.invalidate_caches()
