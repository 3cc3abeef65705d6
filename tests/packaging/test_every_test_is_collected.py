"""A test that pytest does not find never fails: where tests stand, the file's name must say so."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.packaging.source_tree import modules

FILES = modules("tests")


def holds_tests(path: Path) -> bool:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return any(
        (isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"))
        or (isinstance(node, ast.ClassDef) and node.name.startswith("Test"))
        for node in tree.body
    )


def test_files_with_tests_are_named_so_and_files_named_so_have_tests() -> None:
    assert [path for path in FILES if holds_tests(path) != path.name.startswith("test_")] == []


def test_no_two_tests_of_a_file_share_a_name() -> None:
    for path in FILES:
        names = [node.name for node in ast.parse(path.read_text(encoding="utf-8")).body if hasattr(node, "name")]
        doubled = {name for name in names if names.count(name) > 1 and name.startswith(("test_", "Test"))}
        assert not doubled, f"{path}: the second definition hides the first"
