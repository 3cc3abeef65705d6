"""Imports go down only: pipeline -> stages -> truing -> schemas, and between packages of truing as CONTRIBUTING.md
says."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.packaging.source_tree import PACKAGES, PROJECT, imported_names, module_name, modules, within

_SCIENCE = tuple(module_name(path) for path in sorted((PROJECT / "truing").iterdir()) if path.name != "__init__.py")
FORBIDDEN = {
    "schemas": (*_SCIENCE, "truing.stages", "truing.pipeline"),
    "truing": ("truing.stages", "truing.pipeline"),
    "stages": ("truing.pipeline",),
    "truing/estimation": ("truing.calibration", "truing.simulation", "truing.formats", "truing.report", "truing.runs"),
    "truing/inference": ("truing.calibration", "truing.simulation", "truing.formats", "truing.report", "truing.runs"),
    "truing/simulation": ("truing.calibration", "truing.formats", "truing.report", "truing.runs"),
    "truing/quality": ("truing.simulation", "truing.formats", "truing.report", "truing.runs"),
    "truing/calibration": ("truing.formats", "truing.report", "truing.runs"),
    "truing/formats": (
        "truing.calibration",
        "truing.estimation",
        "truing.inference",
        "truing.simulation",
        "truing.report",
        "truing.runs",
    ),
    "truing/report": (
        "truing.calibration",
        "truing.estimation",
        "truing.inference",
        "truing.simulation",
        "truing.formats",
        "truing.runs",
    ),
    "truing/runs": ("truing.formats",),
    "tests/blind/generator": ("truing",),
}
NOT_A_STAGES_BUSINESS = ("argparse", "os", "pathlib", "rich", "shutil", "subprocess", "tempfile", "typer")


def climbing(path: Path, forbidden: tuple[str, ...]) -> list[str]:
    return sorted(name for name in imported_names(path) for package in forbidden if within(name, package))


@pytest.mark.parametrize("folder", FORBIDDEN)
def test_no_module_imports_what_lies_above_or_next_to_it(folder: str) -> None:
    # `python -m truing` is the command line
    own = [path for path in modules(folder) if path != PROJECT / "truing" / "__main__.py"]
    faults = {module_name(path): climbing(path, FORBIDDEN[folder]) for path in own}
    assert not {name: found for name, found in faults.items() if found}


def is_stage(path: Path) -> bool:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names = [target for node in tree.body if isinstance(node, ast.Assign) for target in node.targets]
    names += [node.target for node in tree.body if isinstance(node, ast.AnnAssign)]
    return any(isinstance(name, ast.Name) and name.id == "DECLARATION" for name in names)


def test_a_stage_knows_no_other_stage_no_path_and_no_command_line() -> None:
    stages = [path for path in modules("stages") if is_stage(path)]
    assert stages
    for path in stages:
        others = tuple(module_name(stage) for stage in stages if stage != path)
        assert climbing(path, others + NOT_A_STAGES_BUSINESS) == [], path


def test_open3d_is_imported_in_one_place() -> None:
    importing = {
        path.relative_to(PROJECT).as_posix()
        for package in PACKAGES
        for path in modules(package)
        if climbing(path, ("open3d",)) or '"open3d")' in path.read_text(encoding="utf-8")
    }
    assert importing == {"truing/open3d_library.py"}
