"""Raw files of a campaign, valid or not; reading does not change them."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.formats.reading import SHAPES, read, written
from truing.formats.faultlog import FaultLog
from truing.formats.read import read_table
from truing.formats.source import CampaignFiles, raw_files
from truing.schemas.campaign import read_campaign

POINTS = "pose,body,target,x_mm,y_mm,z_mm\n1,b,T,1,2,3\n"


def campaign(**files):
    return read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, "files": files})


def test_globs_in_natural_order_out_of_the_folder_and_literal_brackets(tmp_path):
    for name in ("raw/p10.txt", "raw/p2.txt", "raw/deep/p1.txt", "here/[a].txt"):
        written(tmp_path, name, POINTS)
    source = CampaignFiles(tmp_path / "here", campaign())
    assert [raw.name for raw in source.resolve("../raw/p*.txt")] == ["../raw/p2.txt", "../raw/p10.txt"]
    assert [raw.name for raw in source.resolve("../raw/**/*.txt")][-1] == "../raw/p10.txt"
    assert [raw.name for raw in source.resolve("[a].txt")] == ["[a].txt"]
    assert source.resolve("none*") == ()


def test_raw_files_of_a_document_are_each_named_once(tmp_path):
    for name in ("points.csv", "targets.csv", "a1.txt", "a2.txt", "joints.txt"):
        written(tmp_path, name, POINTS)
    entries = {"points": [{"path": "a*.txt"}, {"path": ["joints.txt", "a1.txt"]}]}
    document = {"files": entries}
    found = raw_files(tmp_path, document)
    assert [path.name for path in found] == ["a1.txt", "a2.txt", "joints.txt", "targets.csv"]


NONSENSE = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["path", "points", "x"]), inner),
    max_leaves=8,
)


@given(NONSENSE)
def test_a_document_of_nonsense_has_files_all_the_same(tmp_path_factory, files):
    folder = tmp_path_factory.mktemp("nonsense")
    written(folder, "targets.csv", POINTS)
    document = {"files": files}
    found = raw_files(folder, document)
    assert all(path.is_file() for path in found)
    if not (isinstance(files, dict) and "targets" in files):
        assert folder / "targets.csv" in found


def test_reading_never_changes_a_raw_file(tmp_path):
    for name in ("points.csv", "q.csv"):
        written(tmp_path, name, POINTS.replace("3", "oops") if name == "q.csv" else POINTS)
    before = {
        path: (hashlib.sha256(path.read_bytes()).digest(), path.stat().st_mtime_ns) for path in tmp_path.iterdir()
    }
    for path in before:
        path.chmod(0o444)
    read(tmp_path)
    read(tmp_path, entries={"path": "q.csv"})
    after = {path: (hashlib.sha256(path.read_bytes()).digest(), path.stat().st_mtime_ns) for path in tmp_path.iterdir()}
    assert before == after


def test_finding_files_imports_nothing_heavy():
    check = (
        "import sys, truing.formats.source; print([m for m in ('numpy', 'pyarrow', 'pydantic') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


@pytest.mark.parametrize("path", ["sub", "missing.csv"])
def test_a_path_to_no_regular_file_is_a_fault(tmp_path, path):
    (tmp_path / "sub").mkdir()
    (fault,) = read(tmp_path, entries={"path": path}).faults
    assert (fault.file, fault.column, fault.value) == ("campaign.toml", "files.points.path", path)


def test_a_measured_column_of_another_table_is_no_covariate(tmp_path):
    (tmp_path / "log.csv").write_text("pose,A1,x_N1,y_N1,z_N1,x_mm,hall_c\n1,10,1,2,3,4,21.5\n2,20,4,5,6,7,21.6\n")
    files = {
        "points": {"path": "log.csv", "wide": "{axis}_{target}", "constants": {"body": "tip"}},
        "configurations": {"path": "log.csv", "columns": {"A1_deg": "A1"}},
    }
    campaign = read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, "files": files})
    log, source = FaultLog(), CampaignFiles(tmp_path, campaign)
    (batch,) = (batch for _, batch in read_table(source, SHAPES["configurations"], log))
    assert not log
    assert set(batch.columns) == {"pose", "A1_deg", "hall_c"}
