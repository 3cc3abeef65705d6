"""Generated tables of pages are replaced in place, and the rest of the page is unchanged."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.experiments.marked_tables import renew, renewed, table
from tests.docs.shown import shown

PAGE = "before\n<!-- table one -->\nold\n<!-- end -->\nbetween\n<!-- table two -->\nolder\n<!-- end -->\nafter\n"


def test_each_table_is_between_its_marks() -> None:
    page = renewed(PAGE, {"two": lambda: "new", "one": lambda: "newer"})
    assert page == PAGE.replace("older", "new").replace("old", "newer")
    assert shown(page, "one") == "newer"


def test_tables_of_a_page_that_are_not_renewed_stay(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text(PAGE, encoding="utf-8")
    renew(tmp_path / "page.md", {"one": lambda: "new"})
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == PAGE.replace("old\n", "new\n", 1)


def test_a_table_without_a_place_is_named() -> None:
    with pytest.raises(ValueError, match="'three'"):
        renewed(PAGE, {"three": lambda: "new"})


def test_heads_and_rows_become_markdown() -> None:
    assert table(["pose", "mm"], [["1", "0.2"]]) == "| pose | mm |\n| --- | --- |\n| 1 | 0.2 |"


def test_a_row_without_a_cell_for_each_head_is_refused() -> None:
    with pytest.raises(ValueError, match="3 cells under 2 heads"):
        table(["pose", "mm"], [["1", "0.2", "0.3"]])
