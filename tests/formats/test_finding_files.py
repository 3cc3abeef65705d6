"""Files of a path or glob: which are found, at what cost, and which names messages may show."""

from __future__ import annotations

import os
import sys

import pytest

from tests.formats.reading import read, written
from tests.sentences import assert_says
from truing.formats import file_search
from truing.formats.faultlog import shareable_value
from truing.formats.file_search import TooManyEntries, find_files
from truing.schemas.settings_text import read_settings_text

HEAD = "pose,body,target,x_mm,y_mm,z_mm\n"
ROW = "1,b,T,1,2,3\n"


@pytest.fixture
def campaign(tmp_path):
    """A campaign's folder with tables in it, and one next to it."""
    names = ("a.csv", ".h.csv", "sub/a.csv", "sub/deep/x.csv", ".git/x.csv", "pose10/1.csv", "pose2/1.csv", "[x]/a.csv")
    for name in names:
        written(tmp_path / "campaign", name, HEAD + ROW)
    written(tmp_path, "out/o.csv", HEAD + ROW)
    return tmp_path / "campaign"


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("a.csv", ["a.csv"]),
        ("*.csv", ["a.csv"]),
        ("./*.csv", ["a.csv"]),
        (".*.csv", [".h.csv"]),
        ("pose*/*.csv", ["pose2/1.csv", "pose10/1.csv"]),
        ("**/a.csv", ["[x]/a.csv", "a.csv", "sub/a.csv"]),
        ("**/**/x.csv", ["sub/deep/x.csv"]),
        ("sub/**", ["sub/a.csv", "sub/deep/x.csv"]),
        ("[[]x]/*.csv", ["[x]/a.csv"]),
        ("../out/*.csv", ["../out/o.csv"]),
        ("../*/o.csv", ["../out/o.csv"]),
        ("sub", []),
        ("*/", []),
        ("none*", []),
        ("[", []),
        ("a\0b*", []),
        ("../" * 2000 + "*.csv", []),
    ],
)
def test_a_pattern_finds_its_files(campaign, pattern, found):
    names = [name.replace("./", "", 1) if pattern.startswith("./") else name for name in find_files(campaign, pattern)]
    assert sorted(names) == sorted(found)
    assert names == found or "**" in pattern


def test_links_in_a_circle_are_walked_once(campaign):
    """The standard library's walk went forty links deep, along every way of two of them."""
    (campaign / "one").symlink_to(".")
    (campaign / "sub" / "two").symlink_to("..")
    assert {os.path.realpath(campaign / name) for name in find_files(campaign, "**/x.csv")} == {
        str(campaign / "sub" / "deep" / "x.csv")
    }


def test_a_pattern_that_walks_the_disk_is_given_up(campaign, monkeypatch):
    monkeypatch.setattr(file_search, "MOST_ENTRIES", 5)
    with pytest.raises(TooManyEntries):
        find_files(campaign, "**/*.csv")
    (fault,) = read(campaign, entries={"path": "**/*.csv"}).faults
    assert (fault.file, fault.column, fault.value) == ("campaign.toml", "files.points.path", "**/*.csv")
    assert_says(fault.expected, "name", "folders")
    monkeypatch.setattr(file_search, "MOST_ENTRIES", 100)
    monkeypatch.setattr(file_search, "SECONDS", -1.0)
    with pytest.raises(TooManyEntries):
        find_files(campaign, "**/*.csv")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have no /proc")
@pytest.mark.parametrize("path", ["/proc/self/environ", "/proc/self/env*", "linked.csv", "points.csv"])
def test_a_file_of_proc_is_no_table(campaign, path):
    for name in ("linked.csv", "points.csv"):
        (campaign / name).symlink_to("/proc/self/environ")
    mapped = None if path == "points.csv" else {"path": path, "header": False}
    (fault,) = read(campaign, entries=mapped).faults
    assert os.environ["PATH"] not in str(fault)
    assert "regular file" in fault.expected or "existing file" in fault.expected
    with pytest.raises(FileNotFoundError):
        read_settings_text(campaign / "linked.csv")


SECRET = "export TOKEN=hunter2\nexport KEY=correcthorse\n"


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"header": False, "columns": {"x_mm": 1, "y_mm": 1, "z_mm": 1}, "constants": {"pose": 1, "body": "b"}},
        {"separator": "=", "header": False, "columns": {"pose": 1, "x_mm": 2, "y_mm": 2, "z_mm": 2}},
        {"separator": "=", "constants": {"pose": 1, "body": "b"}},
        {"wide": "{target}_{axis}"},
        {"format": "ply"},
        {"format": "pcd"},
        {"format": "gsi"},
        {"format": "rtl"},
        {"format": "trc"},
        {"format": "c3d"},
        {"format": "parquet"},
        {"format": "vstars"},
        {"format": "tracker"},
        {"format": "metashape"},
        {"format": "aicon"},
        {"format": "photomodeler"},
        {"encoding": "utf-16"},
    ],
)
@pytest.mark.parametrize("path", ["../secret", "linked"])
def test_nothing_of_a_file_outside_is_shown_but_numbers(campaign, path, keys):
    written(campaign.parent, "secret", SECRET)
    (campaign / "linked").symlink_to("../secret")
    faults = read(campaign, entries={"path": path, **keys}).faults
    assert faults
    said = "\n".join(map(str, faults))
    assert not any(word in said for word in ("hunter2", "horse", "TOKEN", "KEY"))


@pytest.mark.parametrize("value", ["1,5", "-3.2e-5", "nan", "1.234,5", "12 columns", "", None, "1 234,5"])
def test_numbers_of_a_file_outside_are_shown(value):
    assert shareable_value(value) == value


def test_cells_of_a_table_in_the_folder_are_shown(campaign):
    written(campaign, "points.csv", HEAD + "1,b,T,one,2,3\n")
    (fault,) = read(campaign).faults
    assert (fault.value, fault.row, fault.column) == ("one", 2, "x_mm")
