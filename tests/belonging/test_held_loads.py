"""Runs at constant loads: a slip in some runs is found by the response that most runs have in common."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from truing.belonging.held_loads import against_one_response
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.relation import SIGNAL_FACTORS, RelationState, RelationTest, SlipKind
from truing.belonging.signal_tests import SignalSteps

COUNT, TIMES, NOISE = 60, 3, 1e-6
NAMES = tuple(f"v{k + 1}" for k in range(6))
COLUMNS = [RecordedColumn(name, "signal", SIGNAL_FACTORS) for name in NAMES]
LATE = np.repeat(np.arange(COUNT) >= 33, TIMES)

Change = Callable[[np.ndarray, np.ndarray], None]


def response_test(
    change: Change = lambda load, signal: None, curved: float = 0.0, runs: int = COUNT
) -> RelationTest | None:
    """Test of 60 held loads, three samples each, after a change of loads (180, 6) and signals (180, 6)."""
    rng = np.random.default_rng(7)
    load = rng.uniform(-1.0, 1.0, (COUNT, 6)) * [100.0, 100.0, 200.0, 5.0, 5.0, 5.0]
    share = load / np.abs(load).max(axis=0)
    signal = 2e-3 + 1e-3 * (share @ rng.normal(size=(6, 6)) + curved * share**2 @ rng.normal(size=(6, 6)))
    loads, signals = np.repeat(load, TIMES, axis=0), np.repeat(signal, TIMES, axis=0)
    signals += NOISE * rng.normal(size=signals.shape)
    change(loads, signals)
    run = np.repeat(np.arange(runs), TIMES * COUNT // runs)
    step = np.arange(1, len(run) + 1)
    steps = SignalSteps(loads, run, signals, [f"run {k + 1}" for k in range(runs)], step=step)
    return against_one_response(steps, COLUMNS, "signals-against-loads")


def test_loads_and_signals_that_belong_together_agree() -> None:
    tested = response_test()
    assert tested is not None
    assert (tested.state, tested.slips) == (RelationState.OK, ())
    of_mean, span = NOISE / np.sqrt(TIMES), 4.5e-3  # V
    assert tested.misfit == pytest.approx(100.0 * of_mean / span, rel=0.3)


def test_a_response_that_is_not_linear_is_not_tested() -> None:
    assert response_test(curved=1.0) is None


def test_too_few_loads_are_not_tested() -> None:
    steps = SignalSteps(np.eye(6), np.arange(6), np.eye(6), [f"run {k}" for k in range(6)])
    assert against_one_response(steps, COLUMNS, "signals-against-loads") is None


def late_sign(load: np.ndarray, signal: np.ndarray) -> None:
    signal[LATE, 2] *= -1.0


def late_columns(load: np.ndarray, signal: np.ndarray) -> None:
    signal[np.ix_(LATE, [0, 4])] = signal[np.ix_(LATE, [4, 0])]


def late_kgf(load: np.ndarray, signal: np.ndarray) -> None:
    load[LATE, :3] /= 9.80665


def late_axes(load: np.ndarray, signal: np.ndarray) -> None:
    load[np.ix_(LATE, [0, 1])] = load[np.ix_(LATE, [1, 0])]


@pytest.mark.parametrize(
    ("change", "kind", "subjects"),
    [
        (late_sign, SlipKind.SIGN, ("v3", "from run 34 on")),
        (late_columns, SlipKind.COLUMNS, ("v1", "v5", "from run 34 on")),
        (late_kgf, SlipKind.UNIT, ("from run 34 on",)),
        (late_axes, SlipKind.COLUMNS, ("fx", "fy", "from run 34 on")),
    ],
)
def test_a_slip_in_some_runs_is_named_with_them(change: Change, kind: SlipKind, subjects: tuple[str, ...]) -> None:
    tested = response_test(change)
    assert tested is not None
    assert tested.state is RelationState.FAILS
    (slip,) = tested.slips
    assert (slip.kind, slip.subjects) == (kind, subjects)
    assert (tested.misfit_explained or np.inf) < 1.0 < (tested.misfit or 0.0)


@pytest.mark.parametrize(("runs", "place"), [(1, "from step 100 on"), (2, "from run 2 step 100 on")])
def test_in_a_run_of_several_loads_a_slip_begins_at_a_step(runs: int, place: str) -> None:
    tested = response_test(late_sign, runs=runs)
    assert tested is not None
    assert tested.slips[0].subjects == ("v3", place)


def test_the_unit_of_some_loads_has_its_factor() -> None:
    tested = response_test(late_kgf)
    assert tested is not None
    assert (tested.slips[0].quantity, tested.slips[0].factor) == ("force", pytest.approx(9.80665))


def test_loads_of_other_runs_are_a_shift_of_rows() -> None:
    def change(load: np.ndarray, signal: np.ndarray) -> None:
        load[:] = np.roll(load, TIMES, axis=0)

    tested = response_test(change)
    assert tested is not None
    assert (tested.slips[0].kind, tested.slips[0].shift) == (SlipKind.ROWS_SHIFTED, 1)


def test_a_signal_that_stays_the_same_at_other_loads_is_frozen() -> None:
    def frozen(load: np.ndarray, signal: np.ndarray) -> None:
        signal[LATE, 1] = signal[120, 1]

    tested = response_test(frozen)
    assert tested is not None
    assert tested.state is RelationState.FAILS
    (slip,) = tested.slips
    assert (slip.kind, slip.subjects) == (SlipKind.FROZEN, ("v2", "from run 34 on"))
