"""The common share of the legs is estimated, and pulls stay in their band at every true share."""

from __future__ import annotations

import numpy as np
import pytest

from truing.inference.noise import estimated_share
from truing.inference.pulls import Pulls, pulls

LEGS, PARTS, ROWS, DRAWS = 6, 3, 60, 1200
COMMON = np.arange(PARTS * (1 + LEGS)) < PARTS
HALF = 0.5


def widths(share: float) -> np.ndarray:
    return np.sqrt(np.where(COMMON, share, 1.0 - share))


@pytest.fixture(scope="module")
def jacobian() -> np.ndarray:
    """Rows by parameters: of the legs' own ones the data determine one well, one hardly and one not at all."""
    rng = np.random.default_rng(3)
    of_legs = rng.normal(size=(ROWS, LEGS, PARTS)) * [30.0, 1.0, 0.0]
    common = of_legs.sum(1) + rng.normal(size=(ROWS, PARTS)) * [0.0, 3.0, 10.0]
    return np.concatenate([common, of_legs.reshape(ROWS, -1)], 1)


def fit(jacobian: np.ndarray, rows: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Shift and covariance in prior sigmas at a share."""
    own = jacobian * widths(share)
    covariance = np.linalg.inv(np.eye(own.shape[1]) + own.T @ own)
    return covariance @ own.T @ rows, covariance


def drawn(jacobian: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    return jacobian @ (widths(share) * rng.normal(size=len(COMMON))) + rng.normal(size=ROWS)


def pulls_of(jacobian: np.ndarray, rows: np.ndarray, share: float) -> Pulls:
    shift, covariance = fit(jacobian, rows, share)
    return pulls(shift, np.eye(len(shift)), covariance)


@pytest.mark.slow
def test_pulls_lie_in_their_band_at_the_stated_rate(jacobian: np.ndarray) -> None:
    rng = np.random.default_rng(8)
    inside: dict[str, list[bool]] = {"learned": [], "half": []}
    for angle in rng.uniform(0.0, np.pi / 2, DRAWS):
        rows = drawn(jacobian, np.cos(angle) ** 2, rng)
        learned = estimated_share(*fit(jacobian, rows, HALF), COMMON, HALF)
        for name, share in (("learned", learned), ("half", HALF)):
            one = pulls_of(jacobian, rows, share)
            inside[name].append(one.lower <= one.chi_square <= one.upper)
    spread = np.sqrt(0.95 * 0.05 / DRAWS)
    assert abs(np.mean(inside["learned"]) - 0.95) < 3.3 * spread
    assert np.mean(inside["half"]) < 0.95 - 5.0 * spread  # what would be so without learning


@pytest.mark.parametrize(("share", "low", "high"), [(1.0, 0.999, 1.0), (0.0, 0.0, 0.2), (0.9, 0.75, 0.99)])
def test_the_share_is_reported(jacobian: np.ndarray, share: float, low: float, high: float) -> None:
    rng = np.random.default_rng(2)
    rows = [drawn(jacobian, share, rng) for _ in range(15)]
    assert low < np.median([estimated_share(*fit(jacobian, row, HALF), COMMON, HALF) for row in rows]) <= high


def test_the_estimated_share_is_independent_of_the_share_assumed_by_the_fit(jacobian: np.ndarray) -> None:
    rows = drawn(jacobian, 0.8, np.random.default_rng(4))
    found = [estimated_share(*fit(jacobian, rows, share), COMMON, share) for share in (0.02, 0.3, 0.999)]
    np.testing.assert_allclose(found, found[1], rtol=1e-6)


def test_data_without_information_leave_the_prior_unchanged() -> None:
    assert estimated_share(np.zeros(len(COMMON)), np.eye(len(COMMON)), COMMON, HALF) == HALF
