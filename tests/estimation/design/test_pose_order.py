"""Order of poses: no enumerated order is better, and its two figures are correct."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truing.estimation.design.pose_order import order_poses

seeds = st.integers(0, 2**32 - 1)


def travelled(drives, start, order):
    places = np.concatenate([start[None], drives[order]])
    return np.abs(np.diff(places, axis=0)).max(-1).sum()


def imitated(groups, order):
    """Largest share of a line in time that a least-squares fit of a constant and one group's columns leaves none of."""
    time = np.arange(len(order)) - (len(order) - 1) / 2
    shares = []
    for group in groups:
        columns = np.column_stack([np.ones(len(order)), group[order]])
        fitted = columns @ np.linalg.lstsq(columns, time, rcond=1e-9)[0]
        shares.append(np.sqrt(fitted @ fitted / (time @ time)))
    return max(shares)


@pytest.mark.slow
@settings(max_examples=20)
@given(seeds, st.floats(0, 1))
def test_figures_are_those_of_the_order(seed, trade_off):
    rng = np.random.default_rng(seed)
    drives, start, groups = rng.normal(size=(12, 3)), rng.normal(size=3), rng.normal(size=(2, 12, 4))
    found = order_poses(drives, start, groups, rng, trade_off)
    assert sorted(found.order) == list(range(12))
    assert found.travel == pytest.approx(travelled(drives, start, found.order))
    assert found.drift == pytest.approx(imitated(groups, found.order), abs=1e-9)


@settings(max_examples=10)
@given(seeds)
def test_the_shortest_way_through_few_poses_is_found(seed):
    rng = np.random.default_rng(seed)
    drives, start = rng.uniform(size=(6, 2)), np.zeros(2)
    best = min(travelled(drives, start, list(order)) for order in permutations(range(6)))
    assert order_poses(drives, start, drives[None], rng, 0.0).travel == pytest.approx(best)


def test_along_a_line_travel_and_time_pull_apart():
    drives = np.linspace(0.1, 1.0, 10)[:, None]
    rng = np.random.default_rng(0)
    short, apart = (order_poses(drives, np.zeros(1), drives[None], rng, share) for share in (0.0, 1.0))
    assert short.order.tolist() == list(range(10))
    assert short.drift == pytest.approx(1.0)
    assert apart.drift < 0.02
    assert apart.travel > 2 * short.travel


def test_the_default_gives_up_little_of_either():
    rng = np.random.default_rng(1)
    drives = rng.uniform(-1, 1, (40, 6))
    found = order_poses(drives, np.zeros(6), drives[None], rng)
    assert found.drift < 0.1 < found.random_drift
    assert found.travel < 0.8 * found.random_travel


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_poses_have_an_order_too(count):
    rng = np.random.default_rng(2)
    drives = rng.normal(size=(count, 6))
    assert sorted(order_poses(drives, np.zeros(6), drives[None], rng).order) == list(range(count))


def test_a_trade_off_beyond_its_range_is_refused():
    with pytest.raises(ValueError, match=r"trade-off: found 1.5, expected 0 to 1"):
        order_poses(np.eye(3), np.zeros(3), np.eye(3)[None], np.random.default_rng(0), 1.5)
