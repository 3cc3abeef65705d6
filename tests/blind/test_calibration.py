"""Calibration of unseen machines: parameters, uncertainties, chosen model and predicted poses agree with the truth.

``TRUING_BLIND_SEED`` draws other campaigns. All is judged over all campaigns together, never one by one: a correct
calibration fails a judgement once in a thousand draws.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.blind.calibrated import Calibrated, chi_square_band, coverage_band, mean_square_band, run_all
from tests.blind.generator.campaign import Campaign, draw_campaign
from tests.blind.generator.effects import Effect, LinearDeformation, MatrixDeformation
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.hexapod import draw_hexapod, hexapod_geometry, random_places
from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, Targets, telescope_geometry
from tests.blind.generator.quaternions import Array
from tests.blind.generator.schedule import at_rest, published_moves, random_moves
from tests.blind.generator.telescope import ASSUMED_PARTS
from tests.blind.judging import fewest_of, most_of
from tests.tolerance import assert_between

SEED = int(os.environ.get("TRUING_BLIND_SEED", "1"))
NOT_CHOSEN = 0.05  # of true models: what is called distinguishable is twenty times as probable as they
GOOD_POSE_LOST = 0.05  # of campaigns
BAD_POSE_FOUND = 0.999  # of those that stand out as clearly as here, a hundred times the reading's noise
WITHIN_95 = 1.959964
MISREAD_MM = 0.3
ASKED = {"x": 0.1, "y": 0.1, "z": 0.01, "rx": 0.05, "ry": 0.05}
REQUIREMENT = ("", "[requirement]", *(f"{k}_{'deg' if 'r' in k else 'mm'} = {v}" for k, v in ASKED.items()))

OTHER = telescope_geometry(
    base_radius=260.0,
    platform_radius=200.0,
    base_half_separation_deg=14.0,
    platform_half_separation_deg=8.0,
    length=420.0,
)
LAYOUTS: dict[str, Layout] = {
    "telescope": Layout(name="telescope-like", further_sections=(*ASSUMED_PARTS, *REQUIREMENT)),
    "noisy": Layout(
        name="noisy",
        noise=Noise(point_mm=0.012, actuator_mm=0.002),
        faults=DataFaults(missing_share=0.1, gross_share=0.02),
        surroundings=Surroundings(shuffled=True),
        further_sections=REQUIREMENT,
    ),
    "other": Layout(
        name="other-geometry",
        geometry=OTHER,
        targets=Targets(base=9, platform=7, per_leg=0, follow=0.3),
        noise=Noise(point_mm=0.008),
    ),
    "bare": Layout(name="no-attachments", targets=Targets(base=8, platform=8, on_attachments=(), per_leg=0)),
}
for legs in (3, 5, 6, 8):
    LAYOUTS[f"ups{legs}"] = Layout(
        name=f"hexapod-{legs}",
        geometry=hexapod_geometry(legs),
        targets=Targets(base=10, platform=9, on_attachments=tuple(range(1, legs + 1)), per_leg=0),
        further_sections=REQUIREMENT,
    )
LAYOUTS["ups6-bare"] = replace(
    LAYOUTS["ups6"], noise=Noise(point_mm=0.015, actuator_mm=0.004), targets=Targets(on_attachments=(), per_leg=0)
)

Hidden = Callable[[int, float, np.random.Generator], list[Effect]]


def nothing(legs: int, size: float, rng: np.random.Generator) -> list[Effect]:
    return []


def linear(legs: int, size: float, rng: np.random.Generator) -> list[Effect]:
    return [LinearDeformation(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 2.0, legs) * size)]


def matrix(legs: int, size: float, rng: np.random.Generator) -> list[Effect]:
    return [MatrixDeformation(rng.normal(0.0, size, (legs, legs)))]


@dataclass(frozen=True)
class Kind:
    """A layout, what is hidden in it, and whether two poses' readings are wrong."""

    layout: str
    hidden: Hidden
    misread: bool = False

    @property
    def name(self) -> str:
        return f"{self.layout}-{self.hidden.__name__}{'-misread' if self.misread else ''}"


KINDS = (
    Kind("telescope", nothing),
    Kind("telescope", matrix, misread=True),
    Kind("noisy", matrix),
    Kind("other", linear),
    Kind("bare", nothing, misread=True),
    Kind("bare", linear),
    Kind("ups3", nothing),
    Kind("ups3", matrix, misread=True),
    Kind("ups5", linear),
    Kind("ups6", matrix),
    Kind("ups6-bare", nothing),
    Kind("ups8", matrix, misread=True),
)


def _draw(kind: Kind, rng: np.random.Generator) -> Campaign:
    """A telescope moves by millimetres, a hexapod by centimetres: platforms deform by tens of micrometres in both."""
    layout = LAYOUTS[kind.layout]
    legs = len(layout.geometry.a)
    if layout.geometry.mechanism == "ups":
        campaign = draw_hexapod(layout, random_places(30, 8, rng), kind.hidden(legs, 0.002, rng), rng)
    else:
        moves = published_moves() if kind.layout == "telescope" else random_moves(36, 8, rng)
        campaign = draw_campaign(layout, [at_rest(), *moves], kind.hidden(legs, 0.012, rng), rng)
    return replace(campaign, readings=_misread(campaign, rng)) if kind.misread else campaign


def _misread(campaign: Campaign, rng: np.random.Generator) -> Array:
    """Readings of which a leg's is wrong in two calibration poses."""
    readings = campaign.readings.copy()
    for pose in rng.choice(np.flatnonzero(np.array(campaign.schedule.role) == "calibration"), 2, replace=False):
        readings[pose, rng.integers(readings.shape[1])] += rng.choice([-1.0, 1.0]) * MISREAD_MM
    return readings


def misread(campaign: Calibrated) -> set[str]:
    """The poses whose readings are wrong, as the truth has them."""
    rows = campaign.tables["configurations"].set_index("pose")
    read = rows[[f"rho{leg + 1}_mm" for leg in range(campaign.legs)]]
    true = {pose["pose"]: pose["delta_rho_mm"] for pose in campaign.truth["poses"]}
    wrong = np.abs(read - campaign.truth["geometry"]["rho0_mm"] - np.array([true[n] for n in read.index])).max(axis=1)
    return {str(pose) for pose in read.index[wrong > MISREAD_MM / 2]}


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> list[Calibrated]:
    """All campaigns drawn, written and run; every one of them ends with 0."""
    home = tmp_path_factory.mktemp("calibrated")
    folders = []
    for number, kind in enumerate(KINDS):
        seed = int(np.random.SeedSequence([SEED, 3, number]).generate_state(1)[0])
        folders.append(write_campaign(_draw(kind, np.random.default_rng(seed)), home / kind.name, seed))
    return run_all(folders)


def _asked(campaign: Calibrated) -> dict[str, float]:
    kind = next(kind for kind in KINDS if kind.name == campaign.name)
    return ASKED if REQUIREMENT[-1] in LAYOUTS[kind.layout].further_sections else {}


def test_the_true_model_is_chosen_or_cannot_be_distinguished_from_the_chosen(campaigns: list[Calibrated]) -> None:
    wrong = {campaign.name: campaign.chosen for campaign in campaigns if not campaign.is_chosen_right}
    assert len(wrong) <= most_of(len(campaigns), NOT_CHOSEN), wrong


def test_every_calibration_of_the_chosen_model_converged(campaigns: list[Calibrated]) -> None:
    assert {status for campaign in campaigns for status in campaign.parameters["status"]} == {"ok"}


@pytest.mark.parametrize("of_geometry", [True, False], ids=["geometry", "deformation"])
def test_the_truth_lies_within_the_stated_uncertainty(campaigns: list[Calibrated], of_geometry: bool) -> None:
    errors = [campaign.errors(of_geometry=of_geometry) for campaign in campaigns]
    found, low, high = mean_square_band(errors)
    each = {one.name: round(float(np.mean(e.z**2)), 2) for one, e in zip(campaigns, errors, strict=True) if len(e.z)}
    assert_between(found, low, high, what=f"mean square of (identified - true) / sigma, {each}")
    within, low, high = coverage_band(errors, WITHIN_95, 0.95)
    assert_between(within, low, high, what="share of truths within the 95 % interval")


def test_pulls_agree_with_realistic_tolerances(campaigns: list[Calibrated]) -> None:
    pulls = [campaign.pulls for campaign in campaigns]
    found, low, high = mean_square_band(pulls)
    each = {one.name: round(float(np.mean(p.z**2)), 2) for one, p in zip(campaigns, pulls, strict=True) if len(p.z)}
    assert_between(found, low, high, what=f"mean square of the pulls, {each}")


def test_held_out_observations_are_predicted_to_the_noise(campaigns: list[Calibrated]) -> None:
    squares, expected, spread = (
        sum(column) for column in zip(*(campaign.held_out for campaign in campaigns), strict=True)
    )
    each = {
        campaign.name: round(float(campaign.figures[campaign.chosen]["heldout_ratio"]), 2) for campaign in campaigns
    }
    low, high = chi_square_band(expected**2 / spread)
    assert_between(squares / expected, low, high, what=f"squares held out over their expectation, {each}")


def test_closings_are_as_far_from_zero_as_noise_puts_them(campaigns: list[Calibrated]) -> None:
    squares = sum(campaign.figures[campaign.chosen]["chi_square"] for campaign in campaigns)
    freedom = sum(campaign.figures[campaign.chosen]["freedom"] for campaign in campaigns)
    each = {
        campaign.name: round(float(f["chi_square"] / f["freedom"]), 2)
        for campaign in campaigns
        for f in [campaign.figures[campaign.chosen]]
    }
    assert_between(squares / freedom, *chi_square_band(freedom), what=f"chi-square over its freedom, {each}")


def test_mismeasured_poses_are_named_and_no_others(campaigns: list[Calibrated]) -> None:
    wrong = {(campaign.name, pose) for campaign in campaigns for pose in misread(campaign)}
    named = {(campaign.name, pose) for campaign in campaigns for pose in campaign.left_out}
    assert len(wrong & named) >= fewest_of(len(wrong), BAD_POSE_FOUND), f"missed: {sorted(wrong - named)}"
    assert len({name for name, _ in named - wrong}) <= most_of(len(campaigns), GOOD_POSE_LOST), sorted(named - wrong)


def test_every_pose_and_every_requirement_is_reported(campaigns: list[Calibrated]) -> None:
    for campaign in campaigns:
        if campaign.legs < 6:
            continue
        poses = set(campaign.tables["configurations"]["pose"])
        reported = campaign.tables["accuracy"].groupby(["model", "deformation"])["pose"].agg(set)
        assert reported[campaign.chosen] == poses, campaign.name
        rows = campaign.tables["requirements"]
        assert dict(zip(rows["component"], rows["requirement"], strict=True)) == _asked(campaign), campaign.name
        assert (rows["lower"] <= rows["error"]).all(), campaign.name
        assert (rows["error"] <= rows["upper"]).all(), campaign.name
        verdict = np.where(rows["upper"] <= rows["requirement"], "meets", "undecided")
        verdict[rows["lower"] > rows["requirement"]] = "fails"
        assert rows["verdict"].tolist() == verdict.tolist(), campaign.name


def test_fewer_than_six_legs_do_not_say_where_the_platform_is(campaigns: list[Calibrated]) -> None:
    few = [campaign for campaign in campaigns if campaign.legs < 6]
    assert {one.legs for one in few} == {3, 5}
    for one in few:
        assert one.tables["accuracy"].empty
        assert one.tables["requirements"].empty
        assert "fewer than six legs" in one.said, one.said
