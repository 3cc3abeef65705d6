"""Outliers of readings under loads: single slips, or effects that follow a load or a run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from truing.estimation.interferometry.run_curves import RunCurves, run_curves

SIGMA = 3e-4
LARGEST = np.array([500.0, 500.0, 1000.0, 30.0, 30.0, 30.0])
CHANNEL = 4
SEEDS = range(6)


def _campaign(seed: int, extra: Callable[[np.ndarray], np.ndarray] | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Loads and signals of one run: each load alone, and ninety drawn ones; extra: of one channel, in sigmas."""
    rng = np.random.default_rng(seed)
    alone = np.concatenate([share * np.diag(LARGEST) for share in (0.5, 1.0, -0.5, -1.0)])
    loads = np.vstack([np.zeros((1, 6)), alone, rng.uniform(-0.8, 0.8, (90, 6)) * LARGEST, np.zeros((1, 6))])
    gains = (np.eye(6) + 0.1 * rng.normal(size=(6, 6))) * 1.5 / LARGEST
    signals = loads @ gains.T + 0.01 * rng.normal(size=6) + SIGMA * rng.normal(size=loads.shape)
    signals[:, CHANNEL] += SIGMA * (extra(loads / LARGEST) if callable(extra) else extra)
    return loads, signals


def _curves(loads: np.ndarray, signals: np.ndarray) -> RunCurves:
    count = len(loads)
    return run_curves(loads, 60.0 * np.arange(count), np.zeros(count, np.int64), signals, np.full(signals.shape, SIGMA))


@pytest.mark.parametrize(
    "effect",
    [
        pytest.param(lambda F: 70.0 * F[:, 2] ** 2, id="square"),
        pytest.param(lambda F: 100.0 * F[:, 0] * F[:, 2], id="product"),
        pytest.param(lambda F: 67.0 * ((F[:, 0] > 0.3) & (F[:, 2] > 0.3)), id="two directions together"),
    ],
)
def test_an_effect_of_loads_is_no_gross_error(effect: Callable[[np.ndarray], np.ndarray]) -> None:
    for seed in SEEDS:
        assert not _curves(*_campaign(seed, effect)).rejected.any()


def test_the_square_of_one_load_is_what_a_kept_signal_follows() -> None:
    shared = [one for seed in SEEDS for one in _curves(*_campaign(seed, lambda F: 200.0 * F[:, 2] ** 2)).shared]
    assert shared
    assert all(one.channel == CHANNEL and one.is_predicted and "fz^2" in one.follows for one in shared)


def test_a_pattern_of_outliers_names_the_loads_that_they_share() -> None:
    loads, signals = _campaign(2, lambda F: 67.0 * ((F[:, 0] > 0.3) & (F[:, 2] > 0.3)))
    (one,) = _curves(loads, signals).shared
    assert not one.is_predicted
    assert one.follows in ("fx > 0 and fz > 0", "fx > 0.3 of its range and fz > 0.3 of its range")
    share = loads / LARGEST
    assert one.rows.tolist() == np.flatnonzero((share[:, 0] > 0.3) & (share[:, 2] > 0.3)).tolist()


@pytest.mark.parametrize("bend", [0.0, 20.0])
@pytest.mark.parametrize("count", [1, 3, 6])
def test_slips_at_random_rows_stay_gross_errors(count: int, bend: float) -> None:
    """Next to a bend of the channel as well; so many slips of equal size share an input once in a hundred campaigns."""
    for seed in SEEDS:
        loads, signals = _campaign(seed, lambda F: bend * F[:, 2] ** 2)
        rng = np.random.default_rng([seed, 7])
        rows = rng.choice(len(loads), count, replace=False)
        signals[rows, CHANNEL] += 70.0 * SIGMA * rng.choice([-1.0, 1.0], count)
        found = _curves(loads, signals)
        assert set(rows.tolist()) <= set(np.flatnonzero(found.rejected[:, CHANNEL]).tolist())


def test_exchanged_rows_are_no_pattern() -> None:
    """Neither one pair nor three of neighbours, whose rows deviate by opposite amounts."""
    for seed in SEEDS:
        for first in ([3], [3, 30, 40]):
            loads, signals = _campaign(seed)
            for row in first:
                signals[[row, row + 1]] = signals[[row + 1, row]]
            assert not any(
                set(one.rows.tolist()) & {*first, *(row + 1 for row in first)} for one in _curves(loads, signals).shared
            )


def test_outliers_of_one_run_alone_are_an_effect_of_that_run() -> None:
    """A fault that persists over a run is none of single readings; every fourth reading shows it."""
    rng = np.random.default_rng(3)
    share = np.concatenate([np.linspace(0.0, 1.0, 11), np.linspace(0.9, 0.0, 10)])
    loads = np.zeros((6 * 21, 6))
    loads[:, 2] = np.tile(share, 6) * LARGEST[2]
    run = np.repeat(np.arange(6), 21)
    signals = (loads[:, 2:3] / LARGEST[2] + SIGMA * rng.normal(size=(len(loads), 1))) @ np.ones((1, 1))
    rows = np.flatnonzero(run == 4)[[3, 7, 12, 17]]
    signals[rows, 0] += 60.0 * SIGMA
    found = run_curves(loads, np.arange(len(loads)) * 60.0, run, signals, np.full(signals.shape, SIGMA))
    assert not found.rejected.any()
    (one,) = found.shared
    assert (one.run, one.rows.tolist()) == (4, rows.tolist())
