"""The model of an earlier campaign is copied if it fits the mechanism, and otherwise a fault."""

from __future__ import annotations

import tomllib

import pytest

from tests.stages.test_ingest import CAMPAIGN, LEGS, Folder
from truing.formats.source import raw_files

EARLIER = """format = 1

[model]
campaign = "last"
mechanism = "ups"

[[legs]]
[[legs]]
[[legs]]

[covariance]
names = []

[provenance]
stage = "diagnose"
digest = "0"
"""


@pytest.fixture
def folder(tmp_path):
    made = Folder(tmp_path / "new")
    made.path.mkdir()
    made.toml = CAMPAIGN + LEGS.replace('type = "ups"', 'type = "ups"\nmodel = "../last/model.toml"')
    (tmp_path / "last").mkdir()
    (tmp_path / "last" / "model.toml").write_text(EARLIER)
    return made


def test_the_earlier_model_is_copied_without_where_it_came_from(folder):
    _, left = folder.run()
    assert tomllib.loads(left["start"]) == {k: v for k, v in tomllib.loads(EARLIER).items() if k != "provenance"}


def test_the_prior_model_counts_as_a_raw_file(folder):
    folder.run()
    assert "model.toml" in {path.name for path in raw_files(folder.path, tomllib.loads(folder.toml))}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (None, "a file that can be read"),
        (b"\xff", "a model.toml that a run has written"),
        (b"[model", "a model.toml that a run has written"),
        (b"[effects]\n", "a model.toml that a run has written"),
        (EARLIER.replace("ups", "6-pus").encode(), "a model of a ups, not of a 6-pus"),
        (EARLIER.replace("[[legs]]\n", "", 1).encode(), "a model of 3 legs, not of 2"),
    ],
)
def test_an_unusable_prior_model_is_a_fault(folder, change, expected):
    file = folder.path.parent / "last" / "model.toml"
    if change is None:
        file.unlink()
    else:
        file.write_bytes(change)
    (fault,) = folder.faults()
    assert (fault.file, fault.row, fault.column) == ("campaign.toml", None, "mechanism.model")
    assert fault.value == "../last/model.toml"
    assert fault.expected.startswith(expected)
