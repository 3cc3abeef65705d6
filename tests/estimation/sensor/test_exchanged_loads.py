"""Exchanged rows of loads are named with their components; gross errors and good tables are not."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tests.estimation.sensor.toy_sensor import RANGE, loads, sensor
from tests.tolerance import assert_close
from truing.estimation.sensor.exchanged_loads import exchanged_loads, least_difference, search_exchanges, stray_loads
from truing.estimation.sensor.load_table import LoadTable, load_table


def _table(seed: int, cases: int = 12) -> LoadTable:
    rng = np.random.default_rng(seed)
    return sensor(rng).table(rng, *loads(rng, cases))


def _exchanged(table: LoadTable, first: int, second: int, components: list[int]) -> LoadTable:
    written = table.loads.copy()
    written[np.ix_([first, second], components)] = written[np.ix_([second, first], components)]
    return replace(table, loads=written)


@pytest.mark.parametrize("components", [[1], [0, 1, 2], list(range(6))])
def test_an_exchange_is_named_by_rows_and_components(components):
    for seed in range(4):
        table = _table(seed)
        found = exchanged_loads(_exchanged(table, 13, 27, components))
        assert [(one.first, one.second, list(one.components)) for one in found] == [(13, 27, components)]
        assert found[0].p_value < 1e-6
        assert found[0].after < 3.0 < found[0].before


def test_several_exchanges_are_found_one_after_the_other():
    table = _exchanged(_exchanged(_table(5), 3, 40, [2]), 11, 12, list(range(6)))
    assert {(one.first, one.second) for one in exchanged_loads(table)} == {(3, 40), (11, 12)}


def test_rows_exchanged_in_two_runs_with_the_same_loads_are_reported_within_each():
    """Each of the four rows would fit the load of either run; an exchange within a run is the more probable mistake."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        own, case = loads(rng, 6)
        run = np.concatenate([np.zeros(len(own), int), np.ones(len(own), int)])
        table = replace(sensor(rng).table(rng, np.vstack([own, own]), np.concatenate([case, case])), case=run)
        half = len(own)
        written = _exchanged(_exchanged(table, 13, 14, [0, 1]), half + 13, half + 14, [0, 1])
        found = exchanged_loads(written)
        assert {(one.first, one.second) for one in found} == {(13, 14), (half + 13, half + 14)}


def test_no_exchange_is_found_in_good_tables():
    assert sum(len(exchanged_loads(_table(seed))) for seed in range(20)) == 0


def test_gross_errors_are_not_reported_as_exchanges():
    for seed in range(5):
        table, rng = _table(seed), np.random.default_rng(seed)
        written = table.loads.copy()
        rows = rng.choice(60, 5, replace=False)
        written[rows, rng.integers(6, size=5)] += rng.choice([-1, 1], 5) * 0.3 * RANGE[0]
        assert exchanged_loads(replace(table, loads=written)) == []


def test_an_exchange_is_found_among_larger_gross_errors():
    table = _exchanged(_table(9), 20, 43, [0])
    written = table.loads.copy()
    written[[5, 50], 3] += [0.5 * RANGE[3], -0.5 * RANGE[3]]
    found = exchanged_loads(replace(table, loads=written))
    assert [(one.first, one.second, one.components) for one in found] == [(20, 43, (0,))]


def test_a_component_that_was_never_applied_does_not_disturb():
    table = _table(8)
    without = replace(table, loads=table.loads * (np.arange(6) != 4))
    rest = table.signals - np.outer(table.loads[:, 4], np.linalg.lstsq(table.loads, table.signals, rcond=None)[0][4])
    found = exchanged_loads(_exchanged(replace(without, signals=rest), 4, 30, [5]))
    assert [(one.first, one.second, one.components) for one in found] == [(4, 30, (5,))]


def test_zeros_that_differ_between_runs_are_not_reported_as_exchanges() -> None:
    """Each run loads one axis: a row that misses by the zero of its run could seem exchanged with another row."""
    share = np.concatenate([np.arange(0, 8), np.arange(6, -8, -1), np.arange(-6, 1)]) / 7.0
    applied = np.concatenate([share[:, None] * one for one in np.diag(RANGE)])
    run = np.repeat(np.arange(6), len(share))
    for seed in range(6):
        rng = np.random.default_rng(seed)
        table = sensor(rng, load=1e-4).table(rng, applied, run)
        moved = replace(table, signals=table.signals + 1.5 * rng.normal(size=(6, 6))[run])  # mV, of 10 mV at full load
        assert exchanged_loads(moved) == []
    found = exchanged_loads(_exchanged(moved, 3, 40, [0, 1]))
    assert [(one.first, one.second, one.components) for one in found] == [(3, 40, (0, 1))]


@pytest.mark.slow
def test_many_rows_far_from_their_place_take_little_memory_and_what_was_left_out_is_counted() -> None:
    """Pairs of 1500 far rows, all off to the same side, are 1.1 million, 54 MB for each of the dozen arrays of them."""
    rng = np.random.default_rng(4)
    table = sensor(rng).table(rng, RANGE * rng.uniform(-1.0, 1.0, (6000, 6)), np.zeros(6000, int))
    written = table.loads.copy()
    written[:1500, 3] += RANGE[3] * rng.uniform(0.3, 0.6, 1500)
    tracemalloc.start()
    found, unseen = search_exchanges(replace(table, loads=written))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found == []
    assert unseen > 700_000
    assert peak < 3e8
    assert search_exchanges(_exchanged(table, 13, 27, [1]))[1] == 0


def _long_table(seed: int, count: int, errors: np.ndarray):
    """Loads along one axis in each of 60 runs, signals with errors (count, 6) in shares of what they hold."""
    rng = np.random.default_rng(seed)
    run = np.arange(count) * 60 // count
    applied = np.zeros((count, 6))
    applied[np.arange(count), run % 6] = rng.choice(np.linspace(-100.0, 100.0, 11), count)
    signals = applied @ rng.standard_normal((6, 6))
    return load_table(signals + 0.05 * signals.std(0) * errors, applied, run)


@pytest.mark.parametrize(
    "draw",
    [
        pytest.param(lambda rng: rng.standard_t(2, (6000, 6)), id="each signal"),
        pytest.param(
            lambda rng: rng.standard_normal((6000, 6)) * np.where(rng.random((6000, 1)) < 0.02, 8.0, 1.0),
            id="whole rows",
        ),
    ],
)
@pytest.mark.slow
def test_heavy_tails_are_no_exchanged_rows(draw):
    for seed in range(2):
        assert exchanged_loads(_long_table(seed, 6000, draw(np.random.default_rng([seed, 1])))) == []


@pytest.mark.slow
def test_an_exchange_that_is_larger_than_heavy_tails_is_found_next_to_them():
    table = _long_table(3, 6000, 0.02 * np.random.default_rng(4).standard_t(3, (6000, 6)))
    own = np.flatnonzero((table.case == 7) & (np.abs(table.loads).max(axis=1) > 50.0))
    axis = int(np.abs(table.loads[own[0]]).argmax())
    first, second = int(own[table.loads[own, axis].argmax()]), int(own[table.loads[own, axis].argmin()])
    found = exchanged_loads(_exchanged(table, first, second, [axis]))
    assert [(one.first, one.second) for one in found] == [tuple(sorted((first, second)))]


def test_the_smallest_exchange_that_is_named_is_the_one_that_is_promised():
    """Two loads that differ by half of that are not named, by half as much again they are; noise moves the limit."""
    for seed in range(4):
        table = _table(seed)
        least = least_difference(table)[1]
        apart = np.abs(table.loads[:, None, 1] - table.loads[None, :, 1])
        for share, is_named in ((0.5, False), (2.0, True)):
            first, second = sorted(np.unravel_index(int(np.argmin(np.abs(apart - share * least))), apart.shape))
            found = exchanged_loads(_exchanged(table, int(first), int(second), [1]))
            assert bool(found) is is_named, (seed, share)


def test_an_exchange_that_a_poor_calibration_hides_is_below_what_is_promised():
    """If signals hardly determine a component, exchanged rows of it pass, and the limit is above their loads."""
    rng = np.random.default_rng(6)
    applied = 30.0 * rng.standard_normal((3000, 6))  # so that no curve tells loads better than a matrix
    signals = applied @ rng.standard_normal((6, 6))
    noise = signals.std(0) * rng.standard_normal((3000, 6))
    table = load_table(signals + 0.3 * noise, applied, np.zeros(3000, int))
    first, second = 100, int(np.argmin(np.abs(applied[:, 1] - applied[100, 1] - 60.0)))
    assert exchanged_loads(_exchanged(table, first, second, [1])) == []
    assert least_difference(table)[1] > abs(table.loads[first, 1] - table.loads[second, 1])


def _bent(seed: int, products: float, cubes: float, rows: int = 240, signals: int = 8) -> LoadTable:
    """Rows of loads of a sensor of more signals than loads that bend with all products and cubes of the loads."""
    rng = np.random.default_rng(seed)
    share = np.linspace(-1.0, 1.0, 9)
    applied = np.concatenate([share[:, None] * rng.uniform(-1.0, 1.0, 6) for _ in range(rows // 9)])
    first, second = np.triu_indices(6)
    reported = applied @ rng.normal(size=(6, signals)) + cubes * applied**3 @ rng.normal(size=(6, signals))
    reported += products * (applied[:, first] * applied[:, second]) @ rng.normal(size=(21, signals))
    return load_table(reported + 1e-3 * rng.normal(size=reported.shape), applied * RANGE, np.zeros(len(applied), int))


@pytest.mark.slow
def test_a_strongly_nonlinear_sensor_has_no_exchanged_rows():
    assert sum(len(exchanged_loads(_bent(seed, 2.0, 1.0))) for seed in range(8)) == 0


def test_exchanged_rows_are_found_next_to_clear_nonlinear_terms():
    """The calibration has the terms that are clear, so that exchanged rows stand out from it as from a matrix."""
    for seed in range(3):
        table = _bent(seed, 0.05, 0.0)
        first, second = sorted(np.random.default_rng(seed).choice(len(table.loads), 2, replace=False).tolist())
        found = exchanged_loads(_exchanged(table, first, second, list(range(6))))
        assert [(one.first, one.second) for one in found] == [(first, second)]


def test_no_rows_are_exchanged_where_further_terms_explain_more():
    """Too few rows for the terms themselves: the matrix is kept, whose misfit is no exchange."""
    for seed in range(8):
        assert exchanged_loads(_bent(seed, 2.0, 1.0, rows=90)) == []


@pytest.mark.parametrize("factor", [10.0, -1.0, 0.1])
def test_a_load_with_a_wrong_digit_is_named_with_what_the_signals_ask_for(factor: float) -> None:
    table = _table(seed=3)
    row = int(np.argmax(np.abs(table.loads[:, 2])))
    right = float(table.loads[row, 2])
    table.loads[row, 2] *= factor
    found = stray_loads(table)
    assert found is not None
    assert [(one.row, one.component) for one in found] == [(row, 2)]
    assert_close(found[0].asked, right, atol=0.03 * abs(right))


def test_right_loads_are_not_stray_and_many_wrong_ones_are_no_single_mistakes() -> None:
    table = _table(seed=4)
    assert stray_loads(table) == []
    table.loads[:12] *= 3.0
    assert stray_loads(table) is None


def test_noise_of_nearly_dependent_signals_indicates_no_stray_load() -> None:
    """The recorded load explains the signals of every row, which hardly determine one component."""
    rng = np.random.default_rng(3)
    by_load = rng.normal(size=(6, 6))
    by_load /= np.linalg.norm(by_load, axis=1)[:, None]  # condition 516
    course = [
        0.0,
        0.2,
        0.4,
        0.6,
        0.8,
        1.0,
        0.8,
        0.6,
        0.4,
        0.2,
        0.0,
        -0.2,
        -0.4,
        -0.6,
        -0.8,
        -1.0,
        -0.8,
        -0.6,
        -0.4,
        -0.2,
    ]
    loads = np.concatenate([np.outer(course, axis) for axis in (*np.eye(6), *np.eye(6))])
    signals = 2.0 * loads @ by_load.T + 0.002 * rng.normal(size=loads.shape)
    assert stray_loads(load_table(signals, loads, np.repeat(np.arange(12), len(course)))) == []
