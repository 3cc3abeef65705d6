"""`truing power` for an open chain: its theory agrees with simulated campaigns, and bad input."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.csv
import pytest
from click.testing import Result
from typer.testing import CliRunner

from tests.ignored_causes import search_only
from tests.sentences import assert_says
from truing.pipeline.command_line import app

TOML = """format = 1
[campaign]
name = "small"
kind = "photogrammetry"

[mechanism]
type = "chain"
joints = ["first", "second", "third"]
screws = [
    { axis = [0.0, 0.0, 1.0] },
    { axis = [0.0, 1.0, 0.0], point_mm = [100.0, 0.0, 200.0] },
    { axis = [0.0, 1.0, 0.0], point_mm = [400.0, 0.0, 200.0] },
]
home = { position_mm = [600.0, 0.0, 200.0] }

[mechanism.tolerance]
offset_deg = 0.02
length_mm = 0.1
angle_deg = 0.02

[measurement]
frame = "campaign"

[workspace.joints]
first_deg = [-120.0, 120.0]
second_deg = [-60.0, 60.0]
third_deg = [-90.0, 90.0]

[noise]
point_mm = 0.02
"""


def call(*words: object) -> Result:
    return CliRunner().invoke(app, list(map(str, words)))


TARGETS = "body,target,x_mm,y_mm,z_mm\ntip,A,0,0,0\ntip,B,0,50,0\ntip,C,0,0,50\n"
STATIONS = "base,station:S1,1500,0,0\nbase,station:S2,0,1500,300\nbase,station:S3,-900,-900,800\n"


def _planned(folder: Path, targets: str) -> Path:
    folder.mkdir()
    (folder / "campaign.toml").write_text(TOML)
    (folder / "targets.csv").write_text(targets)
    done = call("design", folder, "--poses", 24, "--out", folder / "configurations.csv")
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small arm without any measurement: planned targets on its tip, and poses that `truing design` chose."""
    return _planned(tmp_path_factory.mktemp("small") / "small", TARGETS)


@pytest.fixture(scope="module")
def ranged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same arm, whose targets are planned to be ranged from three stations: distances instead of points."""
    return _planned(tmp_path_factory.mktemp("ranged") / "ranged", TARGETS + STATIONS)


@pytest.mark.slow
def test_theory_agrees_with_diagnoses_of_simulated_campaigns(planned: Path, tmp_path: Path) -> None:
    """Findings at all sizes together, within three standard deviations of what theory expects."""
    out = tmp_path / "power.csv"
    done = call("power", planned, "--causes", "joint-eccentricity", "--draws", 4, "--workers", 1, "--out", out)
    assert done.exit_code == 0, done.output
    rates = pyarrow.csv.read_csv(tmp_path / "power-rates.csv").to_pylist()
    nothing, *sizes = rates
    assert nothing["cause"] == "nothing"
    assert nothing["found"] <= 0.2  # of 20 campaigns; the rule allows 5 %
    assert {row["cause"] for row in sizes} == {"joint-eccentricity"}
    expected = np.array([row["expected"] for row in sizes])
    campaigns = np.array([row["campaigns"] for row in sizes])
    found = float(np.sum(np.array([row["found"] for row in sizes]) * campaigns))
    spread = np.sqrt(np.sum(campaigns * expected * (1.0 - expected)))
    assert len(sizes) == 5
    assert abs(found - np.sum(campaigns * expected)) < 3.0 * spread
    largest = sizes[-1]
    assert largest["found"] >= 3 / 4
    assert largest["subject_right"] >= 2 / 4


@pytest.mark.slow
def test_theory_agrees_with_diagnoses_that_ignore_other_causes(planned: Path, tmp_path: Path) -> None:
    """Of few causes a lower p-value suffices, but a found one is still clearly more probable than none; and a late or
    an early onset shows less than that of median sensitivity."""
    folder = Path(shutil.copytree(planned, tmp_path / "few"))
    kept = ("joint-eccentricity", "joint-jump", "base-jump", "target-moved")
    search_only(folder, *kept)
    out = tmp_path / "power.csv"
    done = call("power", folder, "--causes", "base-jump,joint-jump", "--draws", 6, "--workers", 1, "--out", out)
    assert done.exit_code == 0, done.output
    sizes = [row for row in pyarrow.csv.read_csv(tmp_path / "power-rates.csv").to_pylist() if row["cause"] != "nothing"]
    expected, found, campaigns = (np.array([row[name] for row in sizes]) for name in ("expected", "found", "campaigns"))
    spread = np.sqrt(np.sum(campaigns * expected * (1.0 - expected)))
    assert len(sizes) == 10
    assert abs(np.sum(campaigns * (found - expected))) < 3.0 * spread


def test_every_cause_of_the_chain_has_its_size(planned: Path, tmp_path: Path) -> None:
    out = tmp_path / "power.csv"
    assert call("power", planned, "--draws", 0, "--out", out).exit_code == 0
    rows = {(r["cause"], r["concerns"]): r for r in pyarrow.csv.read_csv(out).to_pylist()}
    for cause in ("joint-gain", "joint-backlash", "joint-eccentricity", "joint-harmonic"):
        assert 0.0 < rows[cause, "one joint"]["expected_80"] < 1.0
    assert ("joint-compliance", "one joint") not in rows  # no gravity is known


@pytest.mark.parametrize("measured", ["planned", "ranged"])
def test_a_drawn_campaign_can_be_written_and_diagnosed_as_measured(
    measured: str, request: pytest.FixtureRequest
) -> None:
    """The truth of the plan is recovered: a hidden gain within its standard deviation, and none where none is."""
    from truing.pipeline.campaign_folder import open_campaign
    from truing.pipeline.in_memory import chain_tables
    from truing.simulation.cause import Effect
    from truing.simulation.mechanisms.chains.causes import JointGain
    from truing.stages.diagnosis.rows import DetectionAdvice, diagnosis_table
    from truing.stages.diagnosis.search import assembled_data, search_causes
    from truing.stages.power import chain_plan_of

    campaign = open_campaign(request.getfixturevalue(measured))
    settings = campaign.validated()
    plan = chain_plan_of(chain_tables(campaign, settings), settings)
    assert ("distances" in plan.tables) == (measured == "ranged")
    effect = Effect(JointGain("second"), np.array([2e-3]))
    found = {}
    for name, effects in (("gain", (effect,)), ("none", ())):
        data = assembled_data(plan.drawn(effects, np.random.default_rng(5)), settings)
        table = diagnosis_table(search_causes(data, settings, lambda *_: None), DetectionAdvice(shown=data.shown), 0.05)
        # Over this range a gain and an error once per turn are nearly the same: the name may be open.
        reported = {"found", "alternative"}
        found[name] = [row for row in table.to_pylist() if reported & {row["verdict"], row["reason_code"]}]
    assert found["none"] == []
    (row,) = found["gain"]
    assert (row["cause"], row["subject"]) == ("joint-gain", "joint second")
    gain = json.loads(row["parameters"])["gain"]
    assert abs(gain["value"] - 2e-3) < 4.0 * gain["sigma"]


def test_distances_alone_determine_less_than_points(planned: Path, ranged: Path) -> None:
    """Three distances to unsurveyed stations, against three coordinates in a frame that is known to be one."""
    sigmas = []
    for folder in (planned, ranged):
        rows = pyarrow.csv.read_csv(folder / "configurations-numbers.csv").to_pylist()
        own = [row for row in rows if row["kind"] in ("link", "offset")]
        sigmas.append({(row["subject"], row["parameter"]): row["sigma_expected"] for row in own})
    shared = set(sigmas[0]) & set(sigmas[1])
    assert len(shared) >= 8
    ratio = np.array([sigmas[1][key] / sigmas[0][key] for key in shared])
    assert ratio.min() > 0.8
    assert np.median(ratio) >= 1.0


def test_a_target_in_the_origin_of_its_link_can_be_planned(tmp_path: Path) -> None:
    """No rotation of its link moves it, so that this unknown has no effect on any channel."""
    folder = _planned(tmp_path / "single", TARGETS[: TARGETS.index("tip,B")])
    assert len(pyarrow.csv.read_csv(folder / "configurations.csv")) == 24


def test_poses_must_be_planned(planned: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bare"
    folder.mkdir()
    for name in ("campaign.toml", "targets.csv"):
        (folder / name).write_text((planned / name).read_text())
    done = call("power", folder, "--draws", 0)
    assert done.exit_code == 2
    assert_says(" ".join(done.output.split()), "configurations.csv", "planned poses")
