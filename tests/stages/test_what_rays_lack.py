"""A run reports missing data of a rays file: undeclared sigmas, a missing scale."""

from __future__ import annotations

import pytest

from tests.docs.how_to_pages import FOLDER, examples
from truing.pipeline.in_memory import stage_line


@pytest.mark.parametrize(
    ("page", "number", "said", "unsaid"),
    [
        ("colmap", 0, ("6 of them without a standard deviation", "nothing gives their scale"), ()),
        ("photomodeler", 0, ("nothing gives their scale",), ("without a standard deviation",)),
        ("aicon", 1, ("5 of them without a standard deviation",), ("scale",)),
    ],
)
def test_columns_missing_from_a_ray_file_are_named(tmp_path, page, number, said, unsaid):
    line = stage_line(examples(FOLDER / f"{page}.md")[number].write(tmp_path)).call("images")
    words = line.outcomes["images"].read
    assert [one for one in said if one not in words] == []
    assert [one for one in unsaid if one in words] == []
