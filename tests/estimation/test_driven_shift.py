"""The motion that follows the drives: unbiased, with valid limits, and with the stated detection rate."""

from __future__ import annotations

import numpy as np
import pytest

from truing.estimation.driven_shift import DrivenShift, driven_shift
from truing.estimation.response import fit_response, gain_p_value

_ROWS, _DRIVES, _RESPONSES, _DRAWS = 40, 6, 4, 300
_SIGMA = 5e-6
_U = 1.3e-3 * np.sign(np.random.default_rng(0).normal(size=(_ROWS, _DRIVES)))
_COV = np.broadcast_to(_SIGMA**2 * (0.7 * np.eye(_RESPONSES) + 0.3), (_ROWS, _RESPONSES, _RESPONSES))


def _drawn(rng: np.random.Generator, rms: float) -> tuple[DrivenShift, float, float]:
    """Found shift for a K drawn with this rms motion, the true rms, and the p-value of the test."""
    moved = _U @ rng.normal(size=(_DRIVES, _RESPONSES))
    moved *= rms / np.sqrt((moved**2).mean())
    y = moved + rng.normal(size=(_ROWS, _RESPONSES)) @ np.linalg.cholesky(_COV[0]).T
    none, matrix = (fit_response(_U, y, _COV, form=form) for form in ("none", "matrix"))
    return driven_shift(matrix, _U), float(np.sqrt((moved**2).mean())), gain_p_value(none, matrix)


@pytest.mark.slow
@pytest.mark.parametrize("rms", [0.0, 2e-6, 20e-6])
def test_the_limit_holds_as_often_as_stated(rms: float) -> None:
    rng = np.random.default_rng(1)
    found = [_drawn(rng, rms) for _ in range(_DRAWS)]
    share = np.mean([one.upper >= truth for one, truth, _ in found])
    assert 0.95 - 4 * np.sqrt(0.05 * 0.95 / _DRAWS) < share
    assert np.median([one.upper for one, *_ in found]) < 1.5 * max(rms, 2e-6)  # a limit, and no trifle


@pytest.mark.slow
def test_the_rms_is_the_true_one_without_the_noise_of_the_fit() -> None:
    rng = np.random.default_rng(2)
    found = [_drawn(rng, 6e-6) for _ in range(_DRAWS)]
    off = np.array([one.rms**2 - truth**2 for one, truth, _ in found])
    assert abs(off.mean()) < 4 * off.std() / np.sqrt(_DRAWS)


@pytest.mark.slow
def test_the_detectable_size_is_found_with_the_stated_power() -> None:
    rng = np.random.default_rng(3)
    size = _drawn(rng, 0.0)[0].detectable
    share = np.mean([_drawn(rng, size)[2] < 0.01 for _ in range(_DRAWS)])
    assert 0.95 - 4 * np.sqrt(0.05 * 0.95 / _DRAWS) < share < 0.95 + 4 * np.sqrt(0.05 * 0.95 / _DRAWS)
    assert np.mean([_drawn(rng, 0.5 * size)[2] < 0.01 for _ in range(_DRAWS)]) < 0.6


def test_directions_that_are_known_far_better_than_others_leave_a_size() -> None:
    rng = np.random.default_rng(5)
    u = 1.3e-3 * rng.normal(size=(40, 6)) * [1e4, 1.0, 1.0, 1.0, 1.0, 1.0]  # one drive moves much farther
    cov = np.broadcast_to(_SIGMA**2 * np.diag([1e-8, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1e-8]), (40, 8, 8))
    found = driven_shift(fit_response(u, rng.normal(size=(40, 8)) * np.sqrt(np.diag(cov[0])), cov), u)
    assert np.isfinite([found.rms, found.upper, found.detectable]).all()


def test_sizes_scale_with_the_unit_of_the_response() -> None:
    rng = np.random.default_rng(4)
    y = _U @ rng.normal(0.0, 1e-2, (_DRIVES, _RESPONSES)) + _SIGMA * rng.normal(size=(_ROWS, _RESPONSES))
    one = driven_shift(fit_response(_U, y, _COV), _U)
    other = driven_shift(fit_response(_U, 1e6 * y, 1e12 * _COV), _U)
    assert np.allclose(1e6 * np.array([one.rms, one.upper, one.detectable]), [other.rms, other.upper, other.detectable])
