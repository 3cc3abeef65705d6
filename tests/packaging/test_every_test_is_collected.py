"""Every file with tests has a name that pytest collects."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from tests.packaging.source_tree import modules

FILES = modules("tests")


@cache
def defined(path: Path) -> list[tuple[str, bool]]:
    """Names of the functions and classes of a file, and whether each is one of tests."""
    nodes = [node for node in ast.parse(path.read_text(encoding="utf-8")).body if hasattr(node, "name")]
    return [(node.name, node.name.startswith("Test" if isinstance(node, ast.ClassDef) else "test_")) for node in nodes]


def holds_tests(path: Path) -> bool:
    return any(is_test for _, is_test in defined(path))


def test_files_with_tests_are_named_so_and_files_named_so_have_tests() -> None:
    assert [path for path in FILES if holds_tests(path) != path.name.startswith("test_")] == []


def test_no_two_tests_of_a_file_share_a_name() -> None:
    for path in FILES:
        names = [name for name, _ in defined(path)]
        doubled = {name for name in names if names.count(name) > 1 and name.startswith(("test_", "Test"))}
        assert not doubled, f"{path}: the second definition hides the first"
