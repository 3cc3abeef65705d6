"""Later surveys: a moved target counts as a new one from then on, the others are unchanged."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.faults import assert_fault
from tests.stages.test_ingest import PLACES, Folder, plain
from tests.tolerance import assert_close
from truing.schemas.artifacts import ARTIFACTS

HEAD = "survey,body,target,x_mm,y_mm,z_mm,leg"
MORE = np.array([[60.0, -40.0, 30.0], [-20.0, -70.0, 12.0]])
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture
def folder(tmp_path):
    """Six targets on the platform."""
    made = Folder(tmp_path)
    rows = [f"P{i + 4},{','.join(f'{v:.4f}' for v in place)}" for i, place in enumerate(MORE)]
    made.targets += [f"platform,{row}," for row in rows]
    for pose in (1, 2, 3):
        made.points += [f"{pose},platform,{row}" for row in rows]
    return made


def surveyed(folder, moved=None, survey="after", new=None, leg=""):
    """The platform again, turned round and elsewhere; moved: target to its shift in mm."""
    places = {f"P{i}": place for i, place in enumerate(np.vstack([PLACES["platform"], MORE]))} | (new or {})
    rows = []
    for target, place in places.items():
        at = TURN @ (place + np.asarray((moved or {}).get(target, (0, 0, 0)))) + [500.0, -20.0, 7.0]
        rows.append(
            f"{survey},platform,{target},{','.join(f'{v:.4f}' for v in at)},{leg if target in (moved or {}) else ''}"
        )
    path = folder.path / "resurveys.csv"
    before = path.read_text().splitlines() if path.exists() else [HEAD]
    path.write_text("\n".join([*before, *rows]) + "\n")
    return folder


def names_by_pose(tables, like):
    observations = plain(tables["observations"])
    pairs = zip(observations.column("pose").to_pylist(), observations.column("target").to_pylist(), strict=True)
    return [(pose, target) for pose, target in pairs if target.startswith(like)]


def entry(survey="after", **keys):
    return "\n".join(["\n[[resurvey]]", f'survey = "{survey}"', *(f"{k} = {v}" for k, v in keys.items()), ""])


def test_a_moved_target_is_another_one_from_then_on(folder):
    surveyed(folder, {"P2": (0.8, 0.0, -0.3)})
    folder.toml += entry(from_pose=2, by='"Ann"', reason='"fell off"')
    _, tables = folder.run()
    assert names_by_pose(tables, "P2") == [(1, "P2"), (2, "P2@after"), (3, "P2@after")]
    survey = tables["survey"].to_pylist()
    assert [row["target"] for row in survey if row["target"].startswith("P2")] == ["P2", "P2@after"]
    assert_close([survey[-1][f"{a}_mm"] for a in "xyz"], PLACES["platform"][2] + [0.8, 0.0, -0.3], atol=2e-4)
    assert all(0.005 < survey[-1][f"sigma_{a}_mm"] < 0.02 for a in "xyz")
    reported = {row["target"]: row for row in tables["resurveys"].to_pylist()}
    assert not ARTIFACTS["resurveys"].faults(tables["resurveys"])
    assert [name for name, row in reported.items() if row["relocated"]] == ["P2"]
    assert reported["P2"]["holds_as"] == "P2@after"
    assert tables["relabelled"].column("reason").to_pylist() == ["Ann: fell off"]
    assert tables["relabelled"].column("rows").to_pylist() == [2]


def test_points_without_names_are_named_by_the_place_where_they_lie(folder):
    rng, shift = np.random.default_rng(0), np.array([0.8, 0.0, -0.3])
    platform = np.vstack([PLACES["platform"], MORE])
    rows = ["pose,body,x_mm,y_mm,z_mm"]
    for pose in (1, 2, 3):
        moved = platform + np.outer(np.arange(len(platform)) == 2, shift if pose > 1 else 0.0 * shift)
        for body, places in (("base", PLACES["base"]), ("platform", moved)):
            seen = places + 10.0 * pose + 0.005 * rng.standard_normal(places.shape)
            rows += [f"{pose},{body},{','.join(f'{v:.4f}' for v in place)}" for place in seen]
    folder.points = rows
    surveyed(folder, {"P2": shift})
    folder.toml += entry(from_pose=2)
    assert names_by_pose(folder.run()[1], "P2") == [(1, "P2"), (2, "P2@after"), (3, "P2@after")]


def test_a_checking_resurvey_changes_no_coordinates(folder):
    _, before = folder.run()
    _, after = surveyed(folder, {"P2": (0.8, 0.0, -0.3)}).run()
    assert plain(after["observations"]).equals(plain(before["observations"]))
    assert after["survey"].equals(before["survey"])
    assert [row["target"] for row in after["resurveys"].to_pylist() if row["relocated"]] == ["P2"]
    assert not any(after["resurveys"].column("holds_as").to_pylist())


def test_surveys_follow_each_other_and_new_targets_join(folder):
    surveyed(folder, {"P2": (0.8, 0.0, -0.3)}, survey="b", new={"P9": np.array([1.0, 2.0, 40.0])})
    surveyed(folder, {"P2": (-0.5, 0.1, 0.0)}, survey="a")
    folder.toml += entry("a", from_pose=3) + entry("b", from_pose=2)
    _, tables = folder.run()
    assert names_by_pose(tables, "P2") == [(1, "P2"), (2, "P2@b"), (3, "P2@a")]
    added = {row["target"]: row for row in tables["survey"].to_pylist()}
    assert_close([added["P2@a"][f"{a}_mm"] for a in "xyz"], PLACES["platform"][2] + [-0.5, 0.1, 0.0], atol=2e-4)
    assert_close([added["P9"][f"{a}_mm"] for a in "xyz"], [1.0, 2.0, 40.0], atol=2e-4)


@pytest.mark.parametrize(("leg", "joins"), [("1", True), ("", False)])
def test_a_target_at_an_attachment_joins_again_where_it_is_declared(folder, leg, joins):
    folder.targets = [line + "1" if line.startswith("platform,P2,") else line for line in folder.targets]
    surveyed(folder, {"P2": (0.8, 0.0, -0.3)}, leg=leg)
    folder.toml += entry(from_pose=2)
    _, tables = folder.run()
    assert names_by_pose(tables, "P2")[1:] == [(2, "P2@after"), (3, "P2@after")]
    assert ("P2@after" in tables["survey"].column("target").to_pylist()) is joins


@pytest.mark.parametrize(
    ("entries", "stated"),
    [
        (
            entry("aftr"),
            r"resurvey.1.survey: found 'aftr'; expected a survey of resurveys.csv \(after\); did you mean after",
        ),
        (entry(from_pose=9), "resurvey.1.from_pose: found '9'; expected a pose of the campaign"),
        (entry(moved='["P77"]'), "resurvey.1.moved: found 'P77'; expected targets of survey after"),
        (entry() + entry(), "resurvey.2.survey: found 'after'; expected each survey once"),
    ],
)
def test_an_unknown_survey_pose_or_target_is_a_fault(folder, entries, stated):
    surveyed(folder)
    folder.toml += entries
    said = [str(fault) for fault in folder.faults()]
    assert any(re.search(stated, one) for one in said), said


def test_the_name_of_a_moved_target_is_taken_by_no_other(folder):
    folder.targets.append("platform,P2@after,1.0,2.0,3.0,")
    surveyed(folder, {"P2": (0.8, 0.0, -0.3)})
    folder.toml += entry(from_pose=2)
    fault = assert_fault(folder.faults(), value="after")
    assert fault.expected.startswith("another name for the survey: body platform has a target P2@")


def test_missing_inputs_are_named(folder):
    folder.toml += entry(from_pose=2)
    assert any("the table resurveys.csv" in fault.expected for fault in folder.faults())
    surveyed(folder).targets = None
    (folder.path / "targets.csv").unlink()
    fault = assert_fault(folder.faults(), file="resurveys.csv")
    assert fault.expected.startswith("targets.csv, or [files.targets]: ")
