"""What the rooms need beside Python files goes into the wheel."""

from __future__ import annotations

import tomllib
from fnmatch import fnmatch

from tests.packaging.source_tree import PROJECT, ROOMS, modules

SETUPTOOLS = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
PATTERNS = SETUPTOOLS["package-data"]["*"]


def test_every_folder_of_a_room_is_a_package() -> None:
    folders = {path.parent for room in ROOMS for path in modules(room)}
    assert [folder for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []


def test_every_data_file_is_named_by_a_pattern() -> None:
    files = {path for room in ROOMS for path in (PROJECT / room).rglob("*") if path.is_file()}
    data = [path for path in files if path.suffix != ".py" and "__pycache__" not in path.parts]
    assert data
    assert [path for path in data if not any(fnmatch(path.name, pattern) for pattern in PATTERNS)] == []
