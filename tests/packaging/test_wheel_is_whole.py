"""Wheel and source archive contain exactly the required files, and the wheel works without the checkout."""

from __future__ import annotations

import email
import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from fnmatch import fnmatch
from pathlib import Path

import pytest

import truing
from tests.packaging.source_tree import PACKAGES, PROJECT, modules

SETUPTOOLS = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
PATTERNS = SETUPTOOLS["package-data"]["*"]
_BUILD = "import sys; from setuptools import build_meta as b; to = sys.argv[1]; b.build_wheel(to); b.build_sdist(to)"
_WHEEL = f"truing-{truing.__version__}-py3-none-any.whl"
_CALL = "import truing; assert 'installed' in truing.__file__; from truing.pipeline.entry import main; main()"


def _packaged_files(package: Path) -> list[Path]:
    return [path for path in package.rglob("*") if path.is_file() and "__pycache__" not in path.parts]


def _installed(path: Path) -> str:
    """Path in the wheel of a file of the checkout: below the one package."""
    place = path.relative_to(PROJECT)
    return place.as_posix() if place.parts[0] == "truing" else f"truing/{place.as_posix()}"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the source archive, made from a copy of what they are made of."""
    place = tmp_path_factory.mktemp("built")
    for package in PACKAGES:
        shutil.copytree(PROJECT / package, place / "source" / package, ignore=shutil.ignore_patterns("__pycache__"))
    for file in PROJECT.iterdir():
        if file.suffix in (".md", ".toml", ".cff", ".in") or file.name in ("LICENSE", "setup.py"):
            shutil.copy(file, place / "source")
    words = [sys.executable, "-c", _BUILD, str(place)]
    done = subprocess.run(words, cwd=place / "source", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return place


def test_every_folder_of_a_room_is_a_package() -> None:
    folders = {path.parent for package in PACKAGES for path in modules(package)}
    assert [folder for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []


def test_every_data_file_is_named_by_a_pattern() -> None:
    data = [path for package in PACKAGES for path in _packaged_files(PROJECT / package) if path.suffix != ".py"]
    assert data
    assert [path for path in data if not any(fnmatch(path.name, pattern) for pattern in PATTERNS)] == []


def test_the_wheel_holds_the_rooms_and_nothing_else(built: Path) -> None:
    with zipfile.ZipFile(built / _WHEEL) as wheel:
        names = wheel.namelist()
    packages = {_installed(path) for package in PACKAGES for path in _packaged_files(PROJECT / package)}
    about = {name for name in names if name.startswith(f"truing-{truing.__version__}.dist-info/")}
    assert set(names) - about == packages
    assert "truing/py.typed" in names
    assert any(name.endswith("licenses/LICENSE") for name in about)


def test_the_wheel_has_the_metadata_of_the_project(built: Path) -> None:
    with zipfile.ZipFile(built / _WHEEL) as wheel:
        reported = email.message_from_bytes(wheel.read(f"truing-{truing.__version__}.dist-info/METADATA"))
        commands = wheel.read(f"truing-{truing.__version__}.dist-info/entry_points.txt").decode()
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (reported["Name"], reported["Version"]) == ("truing", truing.__version__)
    assert (reported["License-Expression"], reported["Requires-Python"]) == (
        project["license"],
        project["requires-python"],
    )
    assert f"\nlicense: {project['license']}\n" in (PROJECT / "CITATION.cff").read_text(encoding="utf-8")
    assert reported.get_payload() == (PROJECT / "README.md").read_text(encoding="utf-8")
    assert "truing = truing.pipeline.entry:main" in commands


def test_the_source_archive_builds_and_has_its_changes(built: Path) -> None:
    with tarfile.open(built / f"truing-{truing.__version__}.tar.gz") as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"pyproject.toml", "LICENSE", "README.md", "CHANGELOG.md", "CITATION.cff", "truing/py.typed"} <= names
    assert not {name.split("/")[0] for name in names} & {"tests", "benchmarks", "docs"}


def test_the_wheel_runs_without_the_checkout(built: Path) -> None:
    """Unpacked where nothing else is; the libraries are those of this environment."""
    with zipfile.ZipFile(built / _WHEEL) as wheel:
        wheel.extractall(built / "installed")
    shutil.copytree(PROJECT / "sample_data" / "telescope", built / "away" / "telescope")
    environment = {**os.environ, "PYTHONPATH": str(built / "installed"), "PYTHONWARNINGS": "error"}
    for words, output in (
        (["--version"], f"truing {truing.__version__}\n"),
        (["run", "telescope", "--only", "ingest", "--quiet"], ""),
    ):
        done = subprocess.run(
            [sys.executable, "-P", "-c", _CALL, *words],
            cwd=built / "away",
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith(output)
    assert (built / "away" / "runs" / "telescope" / "observations.parquet").is_file()
