"""docs/reference/python/index.md lists the public names of `truing` in the groups of the module, one line each."""

from __future__ import annotations

import re

import truing
from tests.conftest import PROJECT

PAGE = (PROJECT / "docs" / "reference" / "python" / "index.md").read_text(encoding="utf-8")
LISTED = {
    title: dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", body, re.MULTILINE))
    for title, body in re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
}


def test_page_and_module_have_the_same_groups_and_names() -> None:
    expected = {
        group: {name for names in modules.values() for name in names} for group, modules in truing._GROUPS.items()
    }
    assert {title: set(names) for title, names in LISTED.items() if names} == expected


def test_every_name_has_one_line() -> None:
    listed = re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE)
    assert sorted(listed) == sorted(set(listed))
    meanings = [meaning for names in LISTED.values() for meaning in names.values()]
    assert [meaning for meaning in meanings if not 3 <= len(meaning.split()) <= 25] == []


def test_each_class_that_a_function_returns_is_named_as_its_result() -> None:
    """A line "Result of `f`" names a public function."""
    results = re.findall(r"Result of `(\w+)`", PAGE)
    assert len(results) > 5
    assert set(results) <= set(truing.__all__)
