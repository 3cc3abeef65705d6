"""The design parameter beta of flexures by command line: recovered if they bend far, undetermined otherwise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from tests.ignored_causes import search_only
from tests.second_hand import photogrammetry
from tests.second_hand.bending_hexapod import bent_poses
from tests.second_hand.command import run
from tests.second_hand.elastic_hexapod import Hexapod, design
from tests.second_hand.photogrammetry import Noise, Seen, vector
from tests.tolerance import assert_between

POSES = 26
NOMINAL, TOLERANCE = 0.25, 0.1
TRUE = NOMINAL + np.array([0.10, -0.08, 0.12, 0.05, -0.10, 0.06])
OFF = {"a": 0.02e-3, "b": 0.02e-3, "length": 0.05e-3}
NOISE = Noise(point=1.5e-6, actuator=0.3e-6)


@dataclass(frozen=True)
class Campaign:
    """Length of the flexures and half the range of the readings, m."""

    flexure: float
    travel: float

    @property
    def drawing(self) -> Hexapod:
        return replace(design(), flexure_length=self.flexure)

    def readings(self) -> np.ndarray:
        return self.drawing.reading + self.travel * np.random.default_rng(3).uniform(-1, 1, (POSES, 6))

    def tables(self, place: Path) -> dict[str, pd.DataFrame]:
        drawing, rng = self.drawing, np.random.default_rng(4)
        off = {
            name: getattr(drawing, name) + rng.normal(0, size, getattr(drawing, name).shape)
            for name, size in OFF.items()
        }
        p, turn = bent_poses(replace(drawing, **off), self.readings(), TRUE)
        seen = Seen(p, turn.as_matrix(), self.readings(), ["calibration"] * POSES)
        legs = "".join(
            f"  {{ a_mm = {vector(a)}, b_mm = {vector(b)}, length_mm = {1e3 * length:.9f}, rho0_mm = {1e3 * rho:.6f}, "
            f"flexure_length_mm = {1e3 * self.flexure:g} }},\n"
            for a, b, length, rho in zip(drawing.a, drawing.b, drawing.length, drawing.reading, strict=True)
        )
        sections = "[mechanism.tolerance]\n" + "".join(f"{name}_mm = {1e3 * size:g}\n" for name, size in OFF.items())
        sections += f"flexure_beta = {TOLERANCE}\n"
        mechanism = f'type = "ups"\nlegs = [\n{legs}]\n'
        folder = photogrammetry.write(place / "c", seen, mechanism, sections, rng, noise=NOISE)
        # The diagnosis is no part of this: it would search long for what bends the legs.
        return run(search_only(folder), "calibrate", place / "run")


FAR, NEAR = Campaign(0.060, 8e-3), Campaign(0.010, 1e-3)


@pytest.fixture(scope="module")
def far(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    return FAR.tables(tmp_path_factory.mktemp("far"))


@pytest.fixture(scope="module")
def near(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    return NEAR.tables(tmp_path_factory.mktemp("near"))


def _known(tables: dict[str, pd.DataFrame]) -> pd.DataFrame:
    rows = tables["flexure_parameters"].query("model == 'beam' and parameter == 'beta'").sort_values("leg")
    assert len(rows) == 6
    return rows


def _covariance(tables: dict[str, pd.DataFrame]) -> np.ndarray:
    """Of the measured poses of the platform in the base (N, 6, 6), m and rad."""
    rows = tables["poses"].query("body == 'platform' and parent == 'base' and default").sort_values("pose")
    found = np.zeros((len(rows), 6, 6))
    for i in range(6):
        for j in range(i, 6):
            found[:, i, j] = found[:, j, i] = rows[f"cov_{i}_{j}"]
    return found


def _sigma_over_tolerance(campaign: Campaign, covariance: np.ndarray) -> np.ndarray:
    """Of beta (6,) by the poses alone, all other numbers within their tolerances: slopes by differences."""
    drawing, reading = campaign.drawing, campaign.readings()
    straight = np.full(6, NOMINAL)
    p0, turn0 = bent_poses(drawing, reading, straight)

    def slope(machine: Hexapod, rho: np.ndarray, beta: np.ndarray, step: float) -> np.ndarray:
        p, turn = bent_poses(machine, rho, beta)
        return np.hstack([p - p0, (turn * turn0.inv()).as_rotvec()]) / step

    columns = []
    for name, size in OFF.items():
        nominal = getattr(drawing, name)
        for place in np.ndindex(nominal.shape):
            moved = nominal.copy()
            moved[place] += size
            columns.append(slope(replace(drawing, **{name: moved}), reading, straight, 1.0))
    columns += [slope(drawing, reading, straight + TOLERANCE / 10 * one, 0.1) for one in np.eye(6)]
    by_reading = np.stack([slope(drawing, reading + 1e-6 * one, straight, 1e-6) for one in np.eye(6)], -1)
    noise = covariance + NOISE.actuator**2 * by_reading @ np.swapaxes(by_reading, 1, 2)
    rows = np.linalg.solve(np.linalg.cholesky(noise), np.stack(columns, -1)).reshape(-1, len(columns))
    left = np.diag(np.linalg.inv(rows.T @ rows + np.eye(len(columns))))[-6:]
    return (1 / left - 1) ** -0.5


def test_beta_of_flexures_that_bend_far_is_recovered_exactly(far: dict[str, pd.DataFrame]) -> None:
    assert _known(far)["identifiable"].all()
    rows = (
        far["calibration"].query("model == 'beam' and deformation == 'none' and parameter == 'beta'").sort_values("leg")
    )
    squares = (((rows["identified"] - TRUE) / rows["sigma"]) ** 2).sum()
    low, high = (float(chi2.ppf(q, 6)) for q in (1e-3, 1 - 1e-3))
    assert_between(float(squares), low, high, what="squares of beta")
    assert (rows["sigma"] < 0.3 * TOLERANCE).all()


def test_beta_of_flexures_that_hardly_bend_is_unknown(near: dict[str, pd.DataFrame]) -> None:
    assert not _known(near)["identifiable"].any()
    assert (_known(near)["sensitivity_um"] < 0.1 * _known(near)["closure_noise_um"]).all()
    rows = near["calibration"].query("model == 'beam' and deformation == 'none' and parameter == 'beta'")
    assert not rows["identifiable"].any()
    assert np.allclose(rows["sigma"], TOLERANCE, rtol=0.05)


@pytest.mark.parametrize("name", ["far", "near"])
def test_the_sigma_agrees_with_independent_derivatives(name: str, request: pytest.FixtureRequest) -> None:
    tables = request.getfixturevalue(name)
    own = _sigma_over_tolerance({"far": FAR, "near": NEAR}[name], _covariance(tables))
    # one-sided differences of a tenth of the tolerance, and tables that drop the survey's share: some per cent
    np.testing.assert_allclose(_known(tables)["sigma_over_tolerance"], own, rtol=0.1)
