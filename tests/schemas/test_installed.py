"""Entry points of installed packages are kept, and read again after an installation."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from truing.schemas.installed import entry_points

GROUP = "truing.tested"


def _installed(folder: Path, name: str) -> None:
    place = folder / f"{name}-1.0.dist-info"
    place.mkdir()
    (place / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    (place / "entry_points.txt").write_text(f"[{GROUP}]\n{name} = os:curdir\n", encoding="utf-8")


def test_a_package_installed_later_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(tmp_path, "first")
    os.utime(tmp_path, ns=(0, 0))  # long ago: file systems count time in ticks
    monkeypatch.syspath_prepend(str(tmp_path))
    assert entry_points(GROUP).names == {"first"}
    _installed(tmp_path, "second")
    assert entry_points(GROUP).names == {"first", "second"}


def test_packages_of_a_folder_that_left_the_path_are_gone(tmp_path: Path) -> None:
    _installed(tmp_path, "first")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(tmp_path))
        assert entry_points(GROUP).names == {"first"}
    assert entry_points(GROUP).names == set()
