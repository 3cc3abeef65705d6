"""Every example of docs/own-files.md gives the table that the page shows."""

from __future__ import annotations

import csv
import io
import re
import tomllib

import pytest

from tests.conftest import PROJECT
from tests.formats.reading import read, written
from tests.tolerance import assert_close

PAGE = (PROJECT / "docs" / "own-files.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", PAGE, re.M | re.S))
EXAMPLES = {title: body for title, body in SECTIONS.items() if "```toml" in body}


def block(kind: str, body: str) -> str:
    (content,) = re.findall(rf"```{kind}\n(.*?)```", body, re.S)
    return content


@pytest.mark.parametrize("title", EXAMPLES)
def test_the_example_gives_its_table(tmp_path, title):
    body = EXAMPLES[title]
    for name, content in re.findall(r"^`(\S+)`\n\n```text\n(.*?)```", body, re.M | re.S):
        written(tmp_path, name, content)
    table, entries = next(iter(tomllib.loads(block("toml", body))["files"].items()))
    found = read(tmp_path, table, entries)
    assert found.faults == ()
    shown = list(csv.DictReader(io.StringIO(block("csv", body))))
    assert len(found.rows) == len(shown)
    assert [name for name in shown[0] if name not in found.columns] == []
    first = min(found.columns.get("time_s", [0.0]))
    for row, expected in zip(found.rows, shown, strict=True):
        for name, text in expected.items():
            value = row[name] - first if name == "time_s" else row[name]
            if isinstance(value, float):
                assert_close(value, float(text), atol=1e-6, what=name)  # dates are read to a microsecond
            else:
                assert str(value) == text, name


def test_every_key_of_a_mapping_is_shown():
    from truing.schemas.mapping import FileMapping

    shown = set(re.findall(r"^(\w+) = ", "".join(re.findall(r"```toml\n(.*?)```", PAGE, re.S)), re.M))
    reported = set(re.findall(r"`(\w+)(?: = [^`]*)?`", PAGE))
    assert set(FileMapping.model_fields) - shown - reported == set()
