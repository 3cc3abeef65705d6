"""Rare causes, each hidden alone in a small campaign, are named with the right subject and size.

Strong enough that a miss is a defect and not bad luck; seeds are fixed.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tests.blind.generator.campaign import Campaign, draw_campaign
from tests.blind.generator.effects import (
    ActuatorZeroShift,
    ApproachScatter,
    Effect,
    GravitySag,
    InPlaneDeformation,
    LegCompliance,
    LegThermal,
    NoiseBurst,
)
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.hexapod import draw_hexapod, hexapod_geometry, random_places
from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, Targets, Weight
from tests.blind.generator.schedule import at_rest, even_moves
from tests.stages.line import run_line

Row = dict[str, Any]
SURE = 4.0  # sigmas that a fixed seed may be off


def tables_of(
    home: Path, effects: list[Effect], seed: int, poses: int = 30, shuffled: bool = True, noise: Noise | None = None
) -> dict[str, pa.Table]:
    """The tables of a small campaign as far as its diagnosis."""
    rng = np.random.default_rng(seed)
    layout = Layout(
        name="small",
        targets=Targets(base=8, platform=7, per_leg=2),
        noise=noise or Noise(),
        faults=DataFaults(0.02, 0.01),
        surroundings=Surroundings(temperature_step_c=0.4, shuffled=shuffled),
    )
    campaign = draw_campaign(layout, [at_rest(), *even_moves(poses, 6, rng)], effects, rng)
    return run_line(write_campaign(campaign, home / "campaign", seed), "ingest", "pose", "diagnose")[0]


def found_in(home: Path, effects: list[Effect], seed: int, poses: int = 30, shuffled: bool = True) -> list[Row]:
    """The rows of what is found in a small campaign, with their parameters read."""
    tables = tables_of(home, effects, seed, poses, shuffled)
    rows = [row for row in tables["diagnosis"].to_pylist() if row["verdict"] == "found"]
    return [{**row, "parameters": json.loads(row["parameters"])} for row in rows]


def assert_true(row: Row, truth: dict[str, float]) -> None:
    """Each parameter lies within its interval about the truth, and is known to a third of itself."""
    for name, value in truth.items():
        reported = row["parameters"][name]
        assert abs(reported["value"] - value) < SURE * reported["sigma"], (name, reported, value)
        assert reported["sigma"] < abs(value) / 3, (name, reported)


@pytest.mark.parametrize(
    ("alphas", "subject"),
    [((0, 0, 6e-5, 0, 0, 0), "leg3"), ((-2.5e-5, 0, 0, 0, 3.5e-5, 0), "leg1 leg5"), ((4e-5,) * 6, "")],
    ids=["one leg", "two legs", "all legs"],
)
def test_legs_that_grow_with_temperature_are_named(alphas: tuple[float, ...], subject: str, tmp_path: Path) -> None:
    rows = found_in(tmp_path, [LegThermal(np.array(alphas))], 71)
    assert [(row["cause"], row["subject"]) for row in rows] == [("leg-thermal", subject)]
    truth = {f"alpha_{leg}": alpha for leg, alpha in enumerate(alphas, 1) if alpha} if subject else {"alpha": alphas[0]}
    assert_true(rows[0], truth)


def test_growth_that_no_material_has_is_a_dependence_on_the_temperature(tmp_path: Path) -> None:
    """Metals and plastics grow by 1e-6 to 1e-4 per K, and do not shrink: another cause may follow the temperature."""
    (row,) = found_in(tmp_path, [LegThermal(np.array((-5e-5, 0, 0, 0, 7e-5, 0)))], 71)
    assert (row["cause"], row["subject"], row["follows"]) == ("unexplained", "leg1 leg5", "temperature_c")


def _landing(rng: np.random.Generator, poses: int) -> dict[str, np.ndarray]:
    """Landing errors of the actuators (poses, 6) over their sigma: in 12 poses, or of actuator 4 alone."""
    draws = rng.normal(size=(poses, 6))
    late = (np.arange(poses) >= 14) & (np.arange(poses) < 26)
    return {"group": draws * late[:, None], "one": draws * (np.arange(6) == 3)}


@pytest.mark.parametrize("which", ["group", "one"])
def test_actuators_that_land_elsewhere_each_time_are_named(which: str, tmp_path: Path) -> None:
    draws = _landing(np.random.default_rng(5), 41)[which]
    # One true scatter in 27 has a course that a function of some input explains as well, and is suspected only.
    drawn = [
        found_in(tmp_path / str(seed), [ApproachScatter(0.03, draws)], seed, poses=34, shuffled=False)
        for seed in (72, 73, 74)
    ]
    found = [rows for rows in drawn if rows]
    assert len(found) >= 2
    subject = "leg4" if which == "one" else ""
    assert all([(row["cause"], row["subject"]) for row in rows] == [("approach-scatter", subject)] for rows in found)
    rows = found[0]
    assert_true(rows[0], {"scatter": 0.03})
    settings = json.loads(rows[0]["settings"])
    assert settings["direction"] == 0
    if which == "group":  # the groups that are tried begin and end within a few poses of any
        assert abs(int(settings["from_pose"]) - 14) <= 3
        assert abs(int(settings["to_pose"]) - 25) <= 3


def test_noise_that_grows_for_a_while_is_named_and_follows_no_column(tmp_path: Path) -> None:
    own = (np.arange(41) >= 9) & (np.arange(41) < 20)
    rows = found_in(tmp_path, [NoiseBurst(2.5, own)], 75, poses=34, shuffled=False)
    assert [(row["cause"], row["follows"]) for row in rows] == [("noise-burst", "")]
    settings = json.loads(rows[0]["settings"])
    assert abs(int(settings["from_pose"]) - 9) <= 2
    assert abs(int(settings["to_pose"]) - 19) <= 2
    assert_true(rows[0], {"noise_ratio": 2.5})


def test_noise_that_grows_for_a_few_poses_is_named_though_their_order_tells_nothing(tmp_path: Path) -> None:
    """Of fewer than eight poses no correlation between neighbours in time can be tested."""
    during = (np.arange(41) >= 9) & (np.arange(41) < 14)
    rows = found_in(tmp_path, [NoiseBurst(2.5, during)], 75, poses=34, shuffled=False)
    assert [(row["cause"], row["follows"]) for row in rows] == [("noise-burst", "")]
    settings = json.loads(rows[0]["settings"])
    assert abs(int(settings["from_pose"]) - 9) <= 1
    assert abs(int(settings["to_pose"]) - 13) <= 1


@pytest.mark.parametrize(("times", "verdict"), [(0.5, "found"), (2.0, "suspected")])
def test_a_name_is_doubted_only_where_uneven_noise_exceeds_the_declared(
    times: float, verdict: str, tmp_path: Path
) -> None:
    """A third of the poses, at any time of the campaign, have ``times`` the noise of the others, which is declared."""
    alone = (np.arange(6) == 2).astype(float)
    effects = [LegThermal(6e-5 * alone), NoiseBurst(times, np.arange(41) < 14)]
    rows = tables_of(tmp_path, effects, 71, poses=34)["diagnosis"].to_pylist()
    (named,) = [row for row in rows if row["cause"] == "leg-thermal" and row["verdict"] in ("found", "suspected")]
    assert named["verdict"] == verdict


def test_nothing_is_found_where_actuators_land_as_they_should(tmp_path: Path) -> None:
    for seed in (73, 74):
        assert found_in(tmp_path / str(seed), [], seed) == []


@pytest.mark.parametrize(
    ("amount", "subject"),
    [((0, 0, -0.06, 0, 0, 0), "leg3"), ((0.02, -0.04, 0.06, 0.08, -0.1, 0.12), "")],
    ids=["one", "all, by a reference run"],
)
def test_actuators_whose_zeros_shift_are_named_with_their_onset(
    amount: tuple[float, ...], subject: str, tmp_path: Path
) -> None:
    effect = ActuatorZeroShift(np.array(amount), from_pose=17)
    (row,) = found_in(tmp_path, [effect], 76, poses=34, shuffled=False)
    assert (row["cause"], row["subject"]) == ("actuator-zero-shift", subject)
    assert json.loads(row["settings"])["from_pose"] == 17
    assert_true(row, {name: value for name, (value, unit) in effect.parameters().items() if unit})


def test_two_shifts_of_one_actuator_are_suspected_as_steps_of_one_course(tmp_path: Path) -> None:
    one = np.arange(6) == 1
    steps = [ActuatorZeroShift(0.05 * one, 9), ActuatorZeroShift(-0.08 * one, 21)]
    tables = tables_of(tmp_path, list(steps), 76, poses=34, shuffled=False)
    rows = [row for row in tables["diagnosis"].to_pylist() if row["verdict"] == "suspected"]
    named = {(row["cause"], row["subject"], json.loads(row["settings"])["from_pose"]) for row in rows}
    assert named == {("actuator-zero-shift", "leg2", pose) for pose in (9, 21)}


@pytest.mark.parametrize(("share", "verdict"), [(0.87, "found"), (1.15, "found"), (0.6, "suspected")])
def test_a_name_holds_where_noise_is_declared_as_well_as_it_is_known_to_be(
    share: float, verdict: str, tmp_path: Path
) -> None:
    """Declared noise is known to a tenth (one standard deviation); where it is wrong by a factor, an effect may be
    missing."""
    noise = Noise(declared_point_mm=0.005 * share, declared_actuator_mm=0.001 * share)
    one = np.arange(6) == 2
    tables = tables_of(tmp_path, [LegThermal(6e-5 * one)], 71, noise=noise)
    rows = [row for row in tables["diagnosis"].to_pylist() if row["verdict"] in ("found", "suspected")]
    assert [row["verdict"] for row in rows if (row["cause"], row["subject"]) == ("leg-thermal", "leg3")] == [verdict]
    assert verdict != "found" or len(rows) == 1


def _weighed(home: Path, effects: Callable[[Campaign], Effect], seed: int, layout: Layout) -> list[Row]:
    """The rows of what is found on a hexapod of known load, in which something of it is hidden."""
    places = random_places(30, 6, np.random.default_rng(seed))
    plain = draw_hexapod(layout, places, [], np.random.default_rng(seed))
    campaign = draw_hexapod(layout, places, [effects(plain)], np.random.default_rng(seed))
    tables, _ = run_line(write_campaign(campaign, home / "campaign", seed), "ingest", "pose", "diagnose")
    rows = [row for row in tables["diagnosis"].to_pylist() if row["verdict"] == "found"]
    return [{**row, "parameters": json.loads(row["parameters"])} for row in rows]


WEIGHT = Weight((0.6, 0.0, 0.8), 300.0, (10.0, -5.0, 40.0))
HEXAPOD = Layout(
    name="weighed", geometry=hexapod_geometry(), targets=Targets(base=8, platform=6, per_leg=0), weight=WEIGHT
)


@pytest.mark.parametrize("by_pose", [False, True], ids=["the same mass", "another mass each time"])
def test_a_leg_that_gives_way_under_what_it_carries_is_named(by_pose: bool, tmp_path: Path) -> None:
    layout, masses = HEXAPOD, np.full(37, 300.0)
    if by_pose:
        changing = Surroundings(columns=("payload_kg",))
        layout = replace(layout, weight=replace(WEIGHT, mass_kg=None), surroundings=changing)

    def soft(plain: Campaign) -> Effect:
        own = plain.schedule.further.get("payload_kg", masses)
        amount = 2e-4 * (np.arange(6) == 1)  # mm/N
        return LegCompliance(amount, own, np.array(WEIGHT.centre_mm), np.array(WEIGHT.up))

    rows = _weighed(tmp_path, soft, 81, layout)
    assert [(row["cause"], row["subject"]) for row in rows] == [("leg-compliance", "leg2")]
    assert_true(rows[0], {"compliance_2": 0.2})


def test_targets_that_sag_on_a_platform_are_named_all_or_one(tmp_path: Path) -> None:
    sags = {"all": [("A1", 0.05), ("A2", -0.2), ("A3", 0.1), ("P03", 0.3), ("P05", 0.25)], "one": [("P02", 0.25)]}
    for which, own in sags.items():
        rows = _weighed(tmp_path / which, lambda _, own=tuple(own): GravitySag(own, np.array(WEIGHT.up)), 82, HEXAPOD)
        subject = "platform" if which == "all" else "target P02"
        assert [(row["cause"], row["subject"]) for row in rows] == [("gravity-sag", subject)]
        assert_true(rows[0], {f"{name}_sag": sag for name, sag in own if abs(sag) > 0.1})


def test_attachments_that_shift_in_the_plane_are_named(tmp_path: Path) -> None:
    one = np.arange(6) == 3
    rows = found_in(tmp_path, [InPlaneDeformation(0.02 * one, -0.01 * one)], 83)
    assert [(row["cause"], row["subject"]) for row in rows] == [("in-plane-deformation", "leg4")]
    assert_true(rows[0], {"kappa_x_4": 0.02, "kappa_y_4": -0.01})
