"""docs/architecture.md is drawn from the code, and every file and function that it names exists."""

from __future__ import annotations

import ast
import re

import pytest

from docs.experiments.architecture import FIGURES, FLOWS, PACKAGES, PAGE, drawings, imports, shown_arrows, tables
from tests.conftest import PROJECT
from tests.docs.shown import shown

TEXT = PAGE.read_text(encoding="utf-8")
STEPS = [(flow, step) for flow, steps in FLOWS.items() for step in steps]


def test_drawings_and_lists_are_those_of_the_code() -> None:
    """`python -m docs.experiments.architecture` writes them anew."""
    for file, text in drawings().items():
        assert (FIGURES / file).read_text(encoding="utf-8") == text, file
        assert f"figures/{file}" in TEXT
    for name, text in tables().items():
        assert shown(TEXT, name) == text, name


def test_every_package_is_drawn() -> None:
    folders = {path.parent for path in (PROJECT / "truing").glob("*/__init__.py")}
    expected = {path.relative_to(PROJECT).as_posix() for path in folders} | {"pipeline", "stages", "schemas"}
    assert {package.folder for package in PACKAGES} == expected


def test_arrows_imply_every_import_that_leads_down() -> None:
    row = {package.name: package.row for package in PACKAGES}
    arrows = shown_arrows(imports())
    ways = {name: {other for one, other in arrows if one == name} for name in row}
    for _ in row:
        ways = {name: found.union(*(ways[other] for other in found)) for name, found in ways.items()}
    for name, found in imports().items():
        level = {other for other in found if row[other] == row[name]}
        assert {other for other in found if row[other] < row[name]} == set(), name
        assert found - level <= ways[name]
        assert level <= {"inference", "estimation"}


@pytest.mark.parametrize(("flow", "step"), STEPS, ids=[f"{flow}-{step.name}-{step.file}" for flow, step in STEPS])
def test_a_step_names_a_file_and_what_it_defines(flow: str, step) -> None:
    tree = ast.parse((PROJECT / step.file).read_text(encoding="utf-8"))
    defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    assert step.name in defined
    for artifact in re.findall(r"(\w+)\.parquet", step.result):
        from truing.schemas.artifacts import ARTIFACTS

        assert artifact in ARTIFACTS


def test_every_file_that_the_page_names_exists() -> None:
    named = set(re.findall(r"`((?:truing|stages|schemas|pipeline|tests|docs)/[\w./]+)`", TEXT))
    assert len(named) > len({step.file for _, step in STEPS})
    assert [name for name in named if not (PROJECT / name).exists()] == []
