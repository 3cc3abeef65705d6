"""Repeats on both instruments, and the effect of manual exclusions, through the stages and on the page."""

from __future__ import annotations

import tomllib
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from tests import sensor_campaign
from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Targets
from tests.blind.generator.schedule import random_moves
from tests.faults import assert_fault
from tests.stages.line import run_line
from truing.estimation.repeatability import Squares
from truing.report.events_section import during
from truing.report.exclusion_section import excluded
from truing.report.measured_section import measured
from truing.schemas.faults import CampaignFaults
from truing.stages.common.repeats import DECLARED, SAME_LOADS, SAME_READINGS, repeated_poses
from truing.stages.repeats.load_repeats import repeats_of_loads
from truing.stages.repeats.pose_repeats import repeats_of_poses
from truing.stages.repeats.tables import POOLED

REPEATED = 6
# Chance that a right ratio of scatters falls outside, with the degrees of freedom that each test has.
RARE = 1e-4
RULE = '\n[[exclude]]\n{keys}\nby = "M. Keller"\non = 2026-11-20\nreason = "loose"\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Fourteen poses, six of them repeated by declaration; the actuators stop at other positions."""
    rng = np.random.default_rng(5)
    moves = random_moves(14, 2, rng)
    again = [(101 + k, "calibration", moves[k][2]) for k in range(REPEATED)]
    campaign = draw_campaign(Layout(name="plain", targets=Targets(per_leg=0)), [*moves, *again], [], rng)
    made = write_campaign(campaign, tmp_path_factory.mktemp("repeats") / "campaign", 5)
    table = pd.read_csv(made / "configurations.csv")
    table["repeat_of"] = [str(pose - 100) if pose > 100 else "" for pose in table["pose"]]
    table.to_csv(made / "configurations.csv", index=False)
    return made


@pytest.fixture(scope="module")
def line(folder):
    return run_line(folder, "ingest", "pose", "deformation")[0]


def stage_of(tables, kind="photogrammetry", **noise):
    """The rows that the calibrate stage adds, without its calibrations."""
    own = {"actuator_mm": 0.001, "point_mm": 0.005, "signal_mv": sensor_campaign.SIGNAL_MV, **noise}
    settings = SimpleNamespace(
        is_frame_fixed=False, campaign=SimpleNamespace(drives=()), noise=SimpleNamespace(**own), exclude=()
    )
    made = (repeats_of_poses if kind == "photogrammetry" else repeats_of_loads)(tables, settings)
    return tuple(rows.table().to_pandas() for rows in made[:2])


def test_declared_repeats_give_the_noise_though_actuators_stood_elsewhere(line):
    repeats, fits = stage_of(line)
    assert set(repeats["told_by"]) == {DECLARED}
    assert set(repeats["groups"]) == {REPEATED}
    poses = repeats[repeats["repeated"] == "pose"]
    assert list(poses["subject"]) == [*(f"platform {name}" for name in ("x", "y", "z", "rx", "ry", "rz")), POOLED]
    assert list(poses["freedom_of_error"]) == [REPEATED] * 6 + [6 * REPEATED]
    points = repeats[repeats["repeated"] == "point"].set_index("subject")
    assert set(points.index) == {"base targets", "platform targets", POOLED}
    assert (points["freedom_of_error"] > 20.0 * REPEATED).all()
    for row in repeats.itertuples():  # of each against what its noise says, two-sided
        square = Squares(np.array([row.pure_error**2 * row.freedom_of_error]), np.array([row.freedom_of_error]))
        lower, upper = square.interval(1.0 - RARE)
        assert lower[0] < row.declared_sigma < upper[0], row.subject
    assert set(fits["contender"]) == {"linear", "matrix"}
    assert (fits["p_value"] > RARE).all()


def test_a_shift_that_no_model_knows_is_lack_of_fit(line):
    shifts = line["deformation"].to_pandas()
    curved = shifts["leg"] == 3
    shifts.loc[curved, "delta_bz_um"] += 40.0 * (shifts.loc[curved, "delta_rho_mm"].round(1)) ** 2
    table = pa.Table.from_pandas(shifts, schema=line["deformation"].schema, preserve_index=False)
    fits = stage_of({**line, "deformation": table})[1].set_index(["contender", "subject"])
    assert fits.loc[("linear", "leg 3"), "p_value"] < 1e-3
    assert (fits.drop(index="leg 3", level="subject")["p_value"] > RARE).all()


def test_an_attachment_without_targets_shows_nothing_and_warns_of_nothing(line):
    for others in ([1, 2, 4, 5, 6], [1, 2]):  # a matrix takes readings of every leg all the same
        names = ("deformation", "deformation_models")
        few = {name: line[name].filter(pc.is_in(line[name].column("leg"), pa.array(others))) for name in names}
        repeats, fits = stage_of({**line, **few})
        assert "leg 3" not in {*repeats["subject"], *fits["subject"]}
        reported = fits[fits["contender"] == "matrix"].set_index("subject")["p_value"]
        assert {f"leg {leg}" for leg in others} <= set(reported.index)
        assert (reported > RARE).all()


def test_repeats_are_known_by_their_readings_where_no_column_says_so(line):
    plain = line["configurations"].drop_columns(["repeat_of"])
    assert repeated_poses(plain, (), 0.001)[1] == SAME_READINGS
    assert len(repeated_poses(plain, (), 0.02)[0]) == REPEATED  # as far apart as these actuators stand


def test_runs_of_a_bench_show_their_noise(tmp_path):
    readings, signals = sensor_campaign.measured(np.random.default_rng(2), repeats=2)
    sensor_campaign.write_campaign(tmp_path / "bench", readings, signals, sensor_campaign.campaign_toml())
    tables = run_line(tmp_path / "bench", "ingest")[0]
    repeats, fits = stage_of(tables, "interferometer")
    assert set(repeats["told_by"]) == {SAME_LOADS}
    assert set(repeats["repeated"]) == {"reading", "signal"}
    for row in repeats.itertuples():
        square = Squares(np.array([row.pure_error**2 * row.freedom_of_error]), np.array([row.freedom_of_error]))
        lower, upper = square.interval(1.0 - RARE)
        assert lower[0] < row.declared_sigma < upper[0], row.subject
    assert (fits["p_value"] > RARE).all()
    signals["v2_mv"] += 5e-4 * signals["v2_mv"] ** 2  # bent: no line in the loads
    sensor_campaign.write_campaign(tmp_path / "bent", readings, signals, sensor_campaign.campaign_toml())
    bent = stage_of(run_line(tmp_path / "bent", "ingest")[0], "interferometer")[1].set_index("subject")
    assert bent.loc["v2", "p_value"] < 1e-6
    assert (bent.drop(index="v2")["p_value"] > RARE).all()


def test_a_bench_shows_the_effect_of_exclusions(tmp_path):
    readings, _ = sensor_campaign.measured(np.random.default_rng(4), own_channel=True)
    own = (readings["run"] == 3) & (readings["channel"] == "dz")
    readings.loc[own & (readings["step"] == 4), "reading"] += 40.0  # far off, and so no part of the result anyway
    toml = sensor_campaign.campaign_toml() + "".join(RULE.format(keys=f"run = 3\nstep = {step}") for step in (4, 5))
    sensor_campaign.write_campaign(tmp_path / "bench", readings, None, toml)
    effects = run_line(tmp_path / "bench", "ingest", "pose")[0]["exclusion_effects"].to_pandas()
    assert list(effects["subject"]) == ["channel dz"] * 2
    assert list(effects["gross_anyway"]) == [1, 0]
    assert list(effects["rows"]) == [1, 1]
    assert (effects["over_sigma"] > 0.0).all()
    assert (effects["over_sigma"] < 4.0).all()  # of a good reading more


def test_a_repeat_of_nothing_is_a_fault(folder, tmp_path):
    bad = tmp_path / "bad"
    bad.mkdir()
    for file in folder.iterdir():
        (bad / file.name).write_bytes(file.read_bytes())
    table = pd.read_csv(bad / "configurations.csv", dtype={"repeat_of": str}).fillna({"repeat_of": ""})
    table.loc[0, "repeat_of"], table.loc[1, "repeat_of"] = "999", str(table["pose"][1])
    table.to_csv(bad / "configurations.csv", index=False)
    with pytest.raises(CampaignFaults) as caught:
        run_line(bad, "ingest")
    faults = caught.value.faults
    assert assert_fault(faults, column="repeat_of", value="999").expected == "a pose of this table, or nothing"
    (own,) = [fault for fault in faults if fault.value != "999"]
    assert (own.column, own.expected) == ("repeat_of", "another pose than this one, or nothing")


def test_the_page_shows_who_left_out_what_when_and_what_it_would_be_without(folder, tmp_path):
    ruled = tmp_path / "ruled"
    ruled.mkdir()
    for file in folder.iterdir():
        (ruled / file.name).write_bytes(file.read_bytes())
    with (ruled / "campaign.toml").open("a", encoding="utf-8") as file:
        file.write(RULE.format(keys='body = "platform"\ntarget = "P03"') + RULE.format(keys='body = "base"\npose = 3'))
    tables = run_line(ruled, "ingest", "pose")[0]
    assert measured({name: table.to_pandas() for name, table in tables.items()}) is not None  # a column of names, too
    effects = tables["exclusion_effects"].to_pandas().set_index("entry")
    assert list(effects.index) == ["exclude 1", "exclude 2"]
    assert set(effects["decided_on"]) == {"2026-11-20"}
    assert np.isnan(effects.loc["exclude 2", "largest_change"])  # the pose is lost: nothing to be compared with
    one = effects.loc["exclude 1"]
    assert 14 <= one["rows"] <= 22
    assert 0.05 < one["over_sigma"] < 4.0  # one of many targets, as good as the others
    page = excluded({name: table.to_pandas() for name, table in tables.items()})
    captions = {listing.caption: listing for listing in page.listings}
    decided = captions["Decided by a person"]
    assert {row[0] for row in decided.rows} == {"excluded by M. Keller on 2026-11-20: loose"}
    assert "by a person" in page.lead
    by_rule = [listing for caption, listing in captions.items() if "by a rule" in caption]
    assert not any("P03" in row for listing in by_rule for row in listing.rows)


def test_the_page_shows_what_was_repeated(line):
    repeats, fits = stage_of(line)
    section = during({"repeats": repeats, "lack_of_fit": fits})
    assert all(word in section.lead for word in ("poses", "points", "attachments", "repeat_of"))
    assert len(section.listings) == 2
    assert {row[2] for row in section.listings[1].rows} == {"linear", "matrix"}
    assert during({}) is None


def test_lines_for_campaign_toml_mean_the_names_whatever_they_hold():
    name = 'a"b\\c\n<b>[[x]]\t'
    table = pd.DataFrame([{"body": name, "called": name, "target": name, "from_pose": "3", "to_pose": None, "rows": 9}])
    lines = [row[0] for row in during({"likely_names": table}).listings[0].rows]
    assert not any("\n" in line for line in lines)
    wanted = {"body": name, "called": name, "target": name, "from_pose": "3"}
    assert tomllib.loads("\n".join(lines)) == {"renamed": [wanted]}
