"""`truing report`: verdict and page of a run, and its PDF through a browser on PATH."""

from __future__ import annotations

import json
import stat
import sys
from pathlib import Path

import pytest

from tests.pipeline.fake_project import FakeProject
from truing.pipeline.page_pdf import BROWSERS, printed
from truing.pipeline.problems import EnvironmentProblem

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a script that can be run by its name")

_WRITES = """#!/bin/sh
for word; do case $word in --print-to-pdf=*) to=${word#*=};; esac; last=$word; done
printf '%%PDF-1.4 %s' "$last" > "$to"
"""


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that alone is on PATH, next to the shell."""
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "sh").symlink_to("/bin/sh")
    monkeypatch.setenv("PATH", str(folder))
    return folder


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A page under a name that an address has to escape."""
    file = tmp_path / "a run #1" / "report.html"
    file.parent.mkdir()
    file.write_text("<h1>page</h1>")
    return file


def _install(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)
    (folder / name).chmod(stat.S_IRWXU)


@pytest.mark.parametrize("name", BROWSERS)
def test_each_browser_is_found_by_its_name(path: Path, page: Path, name: str) -> None:
    _install(path, name, _WRITES)
    assert printed(page) == b"%PDF-1.4 " + page.as_uri().encode()


def test_the_appendix_is_asked_for_in_the_address(path: Path, page: Path) -> None:
    _install(path, BROWSERS[0], _WRITES)
    assert printed(page, everything=True).endswith(b"/report.html#everything")


@pytest.mark.parametrize(
    ("text", "expected"),
    [("#!/bin/sh\necho cannot open display >&2\nexit 5\n", "ended with code 5: cannot open display"),
     ("#!/bin/sh\nexit 0\n", "wrote no PDF")],
)  # fmt: skip
def test_a_browser_that_fails_is_named_with_its_last_words(path: Path, page: Path, text: str, expected: str) -> None:
    _install(path, BROWSERS[0], text)
    with pytest.raises(EnvironmentProblem, match=expected):
        printed(page)


def test_without_a_browser_the_exit_code_is_4_with_the_cure(ran: FakeProject, path: Path) -> None:
    done = ran.call("report", str(ran.out), "--pdf")
    assert done.returncode == 4
    assert "install Chromium or Google Chrome" in done.stderr
    assert not (ran.out / "report.pdf").exists()


def test_the_pdf_is_next_to_the_page_and_reported_in_json(ran: FakeProject, path: Path) -> None:
    _install(path, "chromium", _WRITES)
    done = ran.call("report", str(ran.out), "--pdf", "--json")
    files = [entry["file"] for entry in json.loads(done.stdout)["files"]]
    assert (done.returncode, files) == (0, [str(ran.out / "report.html"), str(ran.out / "report.pdf")])
    assert (ran.out / "report.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("words", [(".",), ("--pdf", "--out", "page.html", ".")])
def test_a_folder_without_a_page_or_a_file_that_is_no_pdf_is_a_fault(ran: FakeProject, words: tuple[str, ...]) -> None:
    folder = ran.out if "--pdf" in words else ran.campaign
    done = ran.call("report", *words[:-1], str(folder))
    assert done.returncode == 2
    assert "expected" in done.stderr
