"""Leaving out runs one by one agrees with a joint solution; responses to loads are not counted as noise."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.estimation.interferometry.flexible_response import fit_channel, fit_within_runs, response_columns, run_frame

WAY = np.array([0, 1, 2, 3, 4, 3, 2, 1, 0, -1, -2, -3, -4, -3, -2, -1, 0]) / 4.0
NOISE = 0.5


def test_runs_taken_out_one_by_one_are_solved_for_all_at_once():
    rng = np.random.default_rng(1)
    run = np.repeat([0, 1, 2], [9, 14, 11])
    time_s = np.concatenate([np.sort(rng.uniform(0.0, 900.0, n)) for n in (9, 14, 11)])
    shared = rng.normal(size=(len(run), 4))
    shared[:, 3] = shared[:, 0] - 2.0 * shared[:, 1]  # which says nothing new
    kept = rng.random(len(run)) > 0.1
    reading, noise = rng.normal(size=len(run)), rng.uniform(0.5, 2.0, len(run))
    frame = run_frame(run, time_s)
    found = fit_within_runs(frame, shared, reading, noise, kept)
    mine = (run[:, None] == np.arange(3)).astype(float)
    design = np.column_stack([mine, mine * frame.way[:, None], shared[:, :3]])
    white = (kept / noise)[:, None] * design
    theta = np.linalg.lstsq(white, kept / noise * reading, rcond=None)[0]
    assert_close(found.residual, reading - design @ theta, atol=1e-10)
    assert_close(found.drift, theta[3:6], atol=1e-10)
    assert_close(found.drift_sigma, np.sqrt(np.diag(np.linalg.inv(white.T @ white))[3:6]), atol=1e-10)
    assert found.dof == kept.sum() - 9


def test_a_drift_that_goes_as_the_load_does_is_open():
    time_s = np.arange(8.0)
    frame = run_frame(np.zeros(8, np.int64), time_s)
    found = fit_within_runs(
        frame, time_s[:, None], np.random.default_rng(2).normal(size=8), np.ones(8), np.ones(8, bool)
    )
    assert np.isinf(found.drift_sigma).all()


def bench(repeats: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Runs (N,), times (N,) in s and loads (N, 6), fz in odd runs and mx in even ones."""
    run = np.repeat(np.arange(repeats), len(WAY))
    load = np.zeros((len(run), 6))
    load[run % 2 == 0, 3], load[run % 2 == 1, 2] = 100.0, 4000.0
    return run, 60.0 * np.arange(len(run)), load * np.tile(WAY, repeats)[:, None]


def peculiar(run: np.ndarray, time_s: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Response of a platform with hysteresis, play and creep that differs between pushing and pulling."""
    share = load[:, 2] / 4000.0
    size, back = np.abs(share), np.concatenate([[0.0], np.diff(np.abs(share)) < 0.0])
    crept = np.zeros(len(share))
    for n in range(1, len(share)):
        if run[n] == run[n - 1]:
            crept[n] = crept[n - 1] + (1.0 - np.exp(-60.0 / 250.0)) * (share[n] - crept[n - 1])
    answer = 400.0 * share + 12.0 * size + 8.0 * share**3 + 10.0 * back * 4.0 * size * (1.0 - size) * np.sign(share)
    return answer + 5.0 * np.sign(share) + 8.0 * crept + 30.0 * load[:, 3] / 100.0


@pytest.mark.parametrize("seed", range(3))
def test_the_response_to_loads_is_no_noise_and_gross_errors_differ_from_jumps(seed):
    rng = np.random.default_rng(seed)
    run, time_s, load = bench(8)
    reading = peculiar(run, time_s, load) + NOISE * rng.normal(size=len(run)) + 0.7 * rng.normal(size=8)[run]
    reading[[20, 75]] += 30.0
    onset = 5 * len(WAY) + 6
    reading[(run == 5) & (np.arange(len(run)) >= onset)] -= 20.0
    groups = response_columns(load, run, time_s, np.zeros((len(run), 0)))
    fit = fit_channel(reading, np.full(len(run), NOISE), groups, run, time_s, load, np.zeros(6))
    # a run of 17 steps may take a jump for one some steps later, and the readings between for gross errors
    out = set(np.flatnonzero(~fit.kept).tolist())
    assert {20, 75} <= out <= {20, 75, *range(onset - 3, onset + 3)}
    assert np.flatnonzero(fit.jump_p < 1e-4).tolist() == [5]
    assert abs(fit.jump_row[5] - onset) <= 3
    # chi-square over its freedom, four standard deviations; creep is met by two time constants, not by its own
    assert abs(fit.chi_square / fit.dof - 1.0) < 4.0 * np.sqrt(2.0 / fit.dof) + 0.1
    assert not (np.abs(fit.drift) > 5.0 * fit.drift_sigma).any()


def test_a_run_that_begins_on_an_earlier_day_overflows_nothing():
    run, time_s, load = bench(2)
    time_s[run == 1] -= 1e7
    with np.errstate(over="raise"):
        groups = response_columns(load, run, time_s, np.zeros((len(run), 0)))
    assert all(np.isfinite(group).all() for group in groups)
