"""Every code block of every page works: Python runs, commands and settings exist, tables are read.

A block that cannot says why in a remark above it, ``<!-- not run: ... -->``; names that stand for the reader's own
data are announced by ``<!-- given: ... -->`` and come from `tests/docs/given_names.py`.
"""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from tests.docs.campaign_fragment import fault_of_toml
from tests.docs.given_names import GIVEN
from tests.docs.pages import Block, all_blocks, blocks, pages
from tests.docs.shell import commands, fault

LANGUAGES = {"python", "toml", "sh", "powershell", "csv", "json", "xml", "text"}
# What Sphinx puts in their place: names of the public face, another page.
DIRECTIVES = {"{names}", "{include} ../CONTRIBUTING.md", "{include} ../CHANGELOG.md"}
MOST_NOT_RUN = 3
WITH_PYTHON = sorted({block.page for block in all_blocks("python")})


def _named(found: list[Block]) -> list[object]:
    return [pytest.param(block, id=block.place) for block in found if block.not_run is None]


def test_every_block_says_its_language() -> None:
    """Indented blocks have none: what is not known to be Python or a command would be passed over."""
    known = LANGUAGES | DIRECTIVES
    assert [f"{b.place} {b.language}" for page in pages() for b in blocks(page) if b.language not in known] == []


def test_few_blocks_are_not_run_and_each_says_why() -> None:
    left_out = [block for page in pages() for block in blocks(page) if block.not_run is not None]
    assert [block.place for block in left_out if len(block.not_run or "") < 20] == []
    assert len(left_out) <= MOST_NOT_RUN, [block.place for block in left_out]


def test_every_remark_is_above_a_block() -> None:
    """A remark elsewhere has no effect."""
    for page, text in pages().items():
        written = len(re.findall(r"^\s*<!-- (?:given|not run): ", text, re.MULTILINE))
        assert written == sum(bool(block.given) or block.not_run is not None for block in blocks(page)), page


@pytest.fixture
def folder(tmp_path: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Working folder of a page's code: the shortened sample, a copy of it as a user's campaign, and a run."""
    for name, source in (("sample_data", "sample_data"), ("runs", "runs"), ("my-campaign", "sample_data/telescope")):
        shutil.copytree(workplace / source, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", WITH_PYTHON)
def test_the_python_of_a_page_runs(page: str, folder: Path) -> None:
    reported: dict[str, object] = {"__name__": "page"}
    for block in blocks(page):
        if block.file is not None:
            (folder / block.file).write_text(block.text, encoding="utf-8")
        if block.language == "python" and block.not_run is None:
            given = GIVEN[page](reported) if block.given else {}
            reported |= {name: given[name] for name in block.given}
            source = "\n" * block.line + block.text
            exec(compile(source, page, "exec"), reported)


@pytest.mark.parametrize("block", _named(all_blocks("sh", "powershell")))
def test_commands_exist_with_their_options(block: Block) -> None:
    written = {other.file for other in blocks(block.page) if other.file is not None}
    text = block.text.replace("\\", "/") if block.language == "powershell" else block.text
    reported = {" ".join(words): fault(words, written) for words in commands(text)}
    assert reported, "no command"
    assert {words: why for words, why in reported.items() if why is not None} == {}


@pytest.mark.parametrize("block", _named(all_blocks("toml")))
def test_settings_are_known_with_such_values(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    assert fault_of_toml(block.text, pages()[block.page], monkeypatch) is None


@pytest.mark.parametrize("block", _named(all_blocks("csv")))
def test_tables_have_a_header_and_rows_of_its_length(block: Block) -> None:
    header, *rows = csv.reader(io.StringIO(block.text))
    assert len(set(header)) == len(header) > 1
    assert rows
    assert {len(row) for row in rows} == {len(header)}


def test_documents_can_be_read() -> None:
    for block in all_blocks("json", "xml"):
        json.loads(block.text) if block.language == "json" else ET.fromstring(block.text)
