"""No code searches the program's own sentences for facts: columns and enums hold them."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.packaging.source_tree import PACKAGES, PROJECT, modules

# Columns, fields and variables that hold sentences.
PROSE = {"clause", "explanation", "left_out", "message", "next_measurement", "reason", "said", "says", "why"}
PROSE |= {"next_in_short", "sentence", "sentences", "why_not"}
LOOKS = {"startswith", "endswith", "partition", "rpartition", "removeprefix", "removesuffix", "find", "index"}
# Where these names hold something else: the words of a file's own format, or of another library.
FOREIGN = ("truing/formats", "schemas")


def named(node: ast.AST) -> str:
    """The last name of an expression: ``reason`` of ``row["reason"]``, ``row.reason`` and ``str(reason)``."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("str", "cell") and node.args:
        return named(node.args[0])
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
        return str(node.slice.value)
    if isinstance(node, ast.Attribute):
        return named(node.value) if node.attr == "str" else node.attr
    return node.id if isinstance(node, ast.Name) else ""


def looks_into(node: ast.AST) -> bool:
    """Return True if an expression takes a sentence apart or searches it for words."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        asked = node.func
        if asked.attr in LOOKS and node.args and named(asked.value) in PROSE:
            return True
        if asked.attr in ("contains", "match", "fullmatch", "search", "findall", "split") and node.args:
            return named(asked.value) in PROSE or named(node.args[-1]) in PROSE
    if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn):
        literal = isinstance(node.left, ast.Constant) and isinstance(node.left.value, str)
        return literal and named(node.comparators[0]) in PROSE
    return False


def found_in(text: str) -> list[int]:
    """The lines of a module that look into prose."""
    return [node.lineno for node in ast.walk(ast.parse(text)) if isinstance(node, ast.expr) and looks_into(node)]


@pytest.mark.parametrize(
    "line",
    [
        'row["reason"].startswith("excluded by")',
        'str(row["reason"]).startswith("excluded by")',
        '"held out" in facts.explanation',
        'table["reason"].str.contains("by a person")',
        're.search("up to (.*) um", said)',
        'outcome.left_out.partition(": ")',
        'cell(row.message).split(": ")',
    ],
)
def test_code_that_reads_a_sentence_is_detected(line: str) -> None:
    assert found_in(line) == [1]


@pytest.mark.parametrize("line", ['" ".join(said)', "said.split()", 'subject.startswith("leg")', "why in known"])
def test_code_that_composes_a_sentence_is_allowed(line: str) -> None:
    assert found_in(line) == []


def test_no_module_looks_for_a_fact_in_a_sentence() -> None:
    own = [
        p for package in PACKAGES for p in modules(package) if not p.relative_to(PROJECT).as_posix().startswith(FOREIGN)
    ]
    places = [f"{_place(path)}:{line}" for path in own for line in found_in(path.read_text(encoding="utf-8"))]
    assert not places, "make it a column, an enum or a field:\n" + "\n".join(places)


def _place(path: Path) -> str:
    return path.relative_to(PROJECT).as_posix()
