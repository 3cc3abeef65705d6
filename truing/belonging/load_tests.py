"""Tests of a loading campaign: do loads, readings and signals match each other, and the simulation?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Mask
from truing.belonging import signal_tests
from truing.belonging.copied_rows import Values, copied_runs, equal_columns
from truing.belonging.exact_factors import ExactFactor, MainRatios, exact_factor
from truing.belonging.frozen_values import Frozen, constant_columns, frozen
from truing.belonging.held_loads import against_one_response
from truing.belonging.plausible_slips import RecordedColumn, slips_of_all_loads, slips_of_columns, slips_of_run_loads
from truing.belonging.relation import (
    FORCE_UNITS,
    SIGNAL_FACTORS,
    RecordSlip,
    RelationState,
    RelationTest,
    SlipKind,
    named_shortly,
)
from truing.belonging.responses import Responses, responses
from truing.belonging.row_order import can_reverse, order_of_all_rows, row_slips
from truing.belonging.run_parts import RunPart, of_parts, part_concerns, parts
from truing.belonging.signal_tests import SignalSteps
from truing.belonging.silent_columns import DEPARTS, main_responses, scaled_misses, silent_columns, silent_test
from truing.belonging.slip_search import CLEARLY, ExpectedResponse, clear_responses, explain, hidden
from truing.estimation.interferometry.recorded_steps import READING_SI, RecordedSteps

READINGS = "loads-against-readings"
_NO_SUCH = np.log(3.0)  # log ratio of main responses to the expected ones, in most runs
_EVERYWHERE = 0.5  # share of the main responses
_RANGE = 0.003  # least ratio of the largest load to the declared range in a planned campaign
_STIFFNESS = "stiffness in [mechanism]"
MILLIVOLT = 1e-3
_UNTESTED = RelationState.NOT_TESTED
_LEFT_BY_TWO = 0.25  # share of the expected responses that two slips may leave as misfit
_AS_GOOD = 1.5  # times the misfit by signals alone that a slip found in readings may leave
_SAME_SIZE = 1e-9  # tolerance of the logarithm of a factor


def against_simulation(steps: SignalSteps, columns: Sequence[RecordedColumn], compliance: Array) -> RelationTest:
    """Return the test of readings against loads, with the rows (K, 6) of the simulated compliance that columns show."""
    every = responses(steps.load, steps.run, steps.value)
    measured = clear_responses(every, len(columns))
    if not len(measured):
        return RelationTest(READINGS, RelationState.NOT_TESTED, "no-response")
    expected = by_compliance(compliance)
    overall = [*slips_of_all_loads(measured), *slips_of_columns(measured, columns, steps.runs, expected, of_all=True)]
    each = list(slips_of_run_loads(measured, steps.runs, expected))
    broad = [trial for trial in overall if not trial.slip.subjects]
    others = [trial for trial in overall if trial.slip.subjects]
    explained = explain(measured, expected, [*others, *each], broad)
    if explained.slips:
        # Slips that leave most main responses far from expected ones explain by chance what is wrong otherwise, as two
        # factors do that leave much.
        main = main_responses(measured, expected)[0]
        is_far = main.any() and np.median(np.abs(explained.misses[main])) > CLEARLY
        if is_far or (len(explained.slips) > 1 and explained.after > _LEFT_BY_TWO):
            explained = replace(explained, slips=(), rivals=(), after=explained.before)
            return explained.tested(READINGS, RelationState.FAILS, "no-slip", ())
        return explained.tested(READINGS, RelationState.FAILS, "slip", ())
    if (exact := _exact_factor(measured, expected, columns)) is not None:
        sizes = (named_shortly(exact.slip.subjects), 100.0 * exact.before, 100.0 * exact.after, None, "%")
        return RelationTest(READINGS, RelationState.FAILS, "slip", *sizes, (exact.slip,), tried=explained.tried)
    if silent := silent_columns(every, measured, expected, columns, steps.runs):
        return silent_test(READINGS, silent, explained.tried)
    of_all_runs = [trial for trial in overall if not any(name in steps.runs for name in trial.slip.subjects)]
    unseen = (*hidden(measured, expected, of_all_runs), *_hardly_answering(measured, expected, steps.runs))
    return explained.tested(READINGS, *_departure(measured, expected), unseen)


def by_compliance(compliance: Array) -> ExpectedResponse:
    """Return the expected response of columns, from rows (K, 6) of a compliance (6, 6) whose diagonal
    bounds the rest."""
    gives = np.sqrt(np.maximum(np.abs(np.diag(compliance)), 1e-300))
    return ExpectedResponse(compliance, np.maximum(gives, np.abs(compliance / gives).max(axis=1)), gives)


def against_range(load: Array, largest: Array) -> RelationTest | None:
    """Return a test that calls for attention if the loads (N, 6) are only a trace of the declared range (6,).

    The range is NaN where none is declared.
    """
    share = np.abs(load).max(axis=0, initial=0.0) / largest
    loaded = np.isfinite(share) & (share > 0.0)
    if not loaded.any() or np.max(share[loaded]) > _RANGE:
        return None
    most = float(np.max(share[loaded]))
    fitting = [factor for factor in FORCE_UNITS if 0.1 <= factor * most <= 1.0 + 1e-9]
    slips = tuple(RecordSlip(SlipKind.UNIT, "load", (), factor) for factor in fitting[:1])
    return RelationTest(
        READINGS, RelationState.ATTENTION, "trace-of-range", "", 100.0 * most, None, 100.0 * _RANGE, "%", slips, tried=1
    )


def untested(reason: str) -> RelationTest:
    """Return the untested relation where nothing predicts the readings: a common unit or sign of all loads
    cannot show."""
    unseen = (RecordSlip(SlipKind.UNIT, "load"), RecordSlip(SlipKind.SIGN, "load"))
    return RelationTest(READINGS, RelationState.NOT_TESTED, reason, hidden=unseen)


def _hardly_answering(measured: Responses, expected: ExpectedResponse, runs: Sequence[str]) -> tuple[RecordSlip, ...]:
    """Return the slips that cannot show in runs to which no recorded channel responds clearly."""
    main = main_responses(measured, expected)[0]
    idle = tuple(runs[run] for run in np.unique(measured.run).tolist() if not main[measured.run == run].any())
    return tuple(RecordSlip(kind, "reading", idle) for kind in (SlipKind.UNIT, SlipKind.SIGN)) if idle else ()


def _exact_factor(
    measured: Responses, expected: ExpectedResponse, columns: Sequence[RecordedColumn]
) -> ExactFactor | None:
    """Return a unit by whose factor some main responses differ from expected ones, where the others agree."""
    main = measured.subset(main_responses(measured, expected)[0])
    wanted = expected.expected(main.column, main.direction)
    ratios = MainRatios.of_responses(main.column, main.direction, main.size, wanted)
    return None if ratios is None else exact_factor(ratios, columns)


def _departure(measured: Responses, expected: ExpectedResponse) -> tuple[RelationState, str]:
    """Return state and reason where no slip explains the data, from the deviation of main responses from
    expected ones."""
    main, share, wanted = main_responses(measured, expected)
    if not main.any():
        return RelationState.NOT_TESTED, "no-main-response"
    off = scaled_misses(share, wanted)[main]
    if np.quantile(off, _EVERYWHERE) > _NO_SUCH:
        return RelationState.FAILS, "no-slip"
    each = [np.median(off[measured.run[main] == run]) for run in np.unique(measured.run[main])]
    return (RelationState.ATTENTION, "departs") if max(each) > DEPARTS else (RelationState.OK, "agrees")


@dataclass(frozen=True)
class KnownBench:
    """Declared properties of a bench and its sensor.

    ``compliance``: rows (6, 6) of the simulated compliance that channels see. ``leg_forces`` (6, 6): forces along the
    legs per load. ``gain`` (S,) of signals, V/N. ``largest`` (6,) loads, N and N m, and ``signal_mv``, the noise of
    signals, are NaN where not declared. ``tared``: signals are zero at no load.
    """

    channels: Sequence[RecordedColumn]
    compliance: Array | None
    leg_forces: Array | None
    gain: Array | None
    largest: Array
    signal_mv: float
    tared: bool


@dataclass(frozen=True)
class _ValueTable:
    """Readings or signals: values (N, K) by column, the index of the first column among all, and typical noise (K,)."""

    relation: str
    name: str
    columns: Sequence[RecordedColumn]
    first: int
    value: Array
    noise: Array

    def recorded(self, steps: RecordedSteps, runs: Sequence[str], used: Mask, wrong: Sequence[RunPart]) -> _Used:
        """Return the rows (N,) used for responses, without runs of which a part is wrong, or that are constant."""
        indices = range(self.first, self.first + len(self.columns))
        is_wrong = np.isin(steps.run, [fault.run for fault in wrong if part_concerns(fault, indices)])
        value = np.where((used & ~is_wrong)[:, None], self.value, np.nan)
        still = list(constant_columns(steps.load, steps.run, value))
        for column in still:
            value[steps.run == column.run, column.column] = np.nan
        return _Used(SignalSteps(steps.load, steps.run, value, runs, step=steps.step), still)

    def tests(
        self, response: RelationTest, used: _Used, answers: Array, steps: RecordedSteps, wrong: Sequence[RunPart]
    ) -> list[RelationTest]:
        """Return the tests of responses, parts, columns and rows; responses without a slip are left out if the others
        find any."""
        response = _also_reversed(response, used.steps, self.name)
        tests_made = [
            *of_parts(wrong, steps.step, used.steps.runs, self.columns, self.first, self.relation),
            *equal_columns(self.value, self.columns, self.relation, self.name),
            *self._of_rows(used, answers, steps.time_s),
        ]
        return [*([] if tests_made and not response.slips else [response]), *tests_made]

    def _of_rows(self, used: _Used, answers: Array, time_s: Array) -> Iterator[RelationTest]:
        """Return the tests of constant columns, and of runs whose rows are in another order than their loads."""
        steps = used.steps
        still = [*used.still, *frozen(steps.load, steps.run, steps.value, answers, self.noise)]
        share = 100.0 * max((place.share for place in still), default=0.0)
        for slip in _frozen_slips(still, self.columns, steps.runs):
            reported = (named_shortly(slip.subjects), share, None, None, "%")
            yield RelationTest(self.relation, RelationState.FAILS, "frozen", *reported, (slip,), tried=len(still))
        if not still:
            slips_of_rows, tried = row_slips(steps.load, steps.run, time_s, steps.value, steps.runs, self.name)
            if not slips_of_rows and (whole := order_of_all_rows(steps.load, steps.run, steps.value, self.name)):
                slips_of_rows = [whole]
            for row in slips_of_rows:
                sizes = (named_shortly(row.slip.subjects), row.before, row.after, None, "% of the range")
                yield RelationTest(self.relation, RelationState.FAILS, "rows", *sizes, (row.slip,), tried=tried)


@dataclass(frozen=True)
class _Used:
    """Rows and columns of a table that are used for responses, and the constant ones."""

    steps: SignalSteps
    still: list[Frozen]


def relate_loads(steps: RecordedSteps, known: KnownBench) -> tuple[RelationTest, ...]:
    """Return the tested relations of the loads, readings and signals of a bench, and between runs."""
    runs = [f"run {run}" for run in steps.runs]
    copies = copied_runs(steps.run, runs, steps.load, _values(steps, known))
    alone = ~np.isin(steps.run, [runs.index(name) for copy in copies for slip in copy.slips for name in slip.subjects])
    signals = [RecordedColumn(name, "signal", SIGNAL_FACTORS) for name in steps.signals]
    wrong = _parts(steps, [*known.channels, *signals], known.compliance)
    tests: list[RelationTest] = []
    if np.isfinite(steps.reading).any():
        noise = _typical(steps.sigma)
        of = _ValueTable(READINGS, "readings", known.channels, 0, steps.reading, noise)
        used = of.recorded(steps, runs, alone, wrong)
        response = _test_readings(used.steps, known)
        answers = (
            signal_tests.responses_of(used.steps, len(known.channels)) if known.compliance is None else known.compliance
        )
        tests += of.tests(response, used, answers, steps, wrong)
    else:
        in_range = against_range(steps.load, known.largest)
        tests.append(in_range or untested("no-displacements"))
    if signals:
        noise = np.full(len(signals), known.signal_mv * MILLIVOLT)
        of = _ValueTable(signal_tests.RELATION, "signals", signals, len(known.channels), steps.signal, noise)
        used = of.recorded(steps, runs, alone, wrong)
        used = replace(used, steps=replace(used.steps, tared=known.tared))
        tests[0], response = _reconciled(tests[0], _test_signals(used.steps, signals, known))
        response = _test_with_load_slip(tests[0], response, used.steps, signals, known)
        answers = signal_tests.responses_of(used.steps, len(signals))
        tests += of.tests(response, used, answers, steps, wrong)
    return (*tests, *copies)


def _reconciled(readings: RelationTest, signals: RelationTest) -> tuple[RelationTest, RelationTest]:
    """Return both tests with a slip that both find first; where readings match the prediction, loads are right."""
    known = (*signals.slips, *signals.rivals)
    common = [slip for slip in (*readings.slips, *readings.rivals) if slip in known]
    if len(readings.slips) == len(signals.slips) == 1 and common:
        return _with_first_slip(readings, common[0]), _with_first_slip(signals, common[0])
    runs = readings.slips[0].subjects if len(readings.slips) == 1 and readings.slips[0].quantity == "load" else ()
    if (
        runs
        and signals.state == RelationState.OK
        and not any(set(slip.subjects) & set(runs) for slip in signals.hidden)
    ):
        moved = [slip for slip in readings.rivals if slip.quantity in ("displacement", "rotation")]
        return (_with_first_slip(readings, moved[0]) if moved else readings), signals
    stiffness = [slip for slip in readings.rivals if slip.quantity == _STIFFNESS]
    loads_right = signals.state == RelationState.OK and all(slip.quantity != "load" for slip in signals.hidden)
    if stiffness and loads_right:
        return _with_first_slip(readings, stiffness[0]), signals
    signal_slips = [slip for slip in signals.rivals if slip.quantity == "signal"]
    right = readings.state == RelationState.OK and all(slip.quantity != "load" for slip in readings.hidden)
    if right and signal_slips and len(signals.slips) == 1 and signals.slips[0].quantity == "load":
        return readings, _with_first_slip(signals, signal_slips[0])
    return readings, signals


def _test_with_load_slip(
    readings: RelationTest,
    signals: RelationTest,
    recorded: SignalSteps,
    columns: Sequence[RecordedColumn],
    known: KnownBench,
) -> RelationTest:
    """Return the test of signals with the slip of loads found from readings, if it explains all signals."""
    if readings.state != RelationState.FAILS or not signals.slips or len(readings.slips) != 1:
        return signals
    slip = readings.slips[0]
    if slip == signals.slips[0] or slip.subjects or slip.kind not in (SlipKind.UNIT, SlipKind.SIGN):
        return signals
    axes = {"load": slice(0, 6), "force": slice(0, 3), "torque": slice(3, 6)}.get(slip.quantity)
    if axes is None:
        return signals
    load = recorded.load.copy()
    load[:, axes] *= -1.0 if slip.kind == SlipKind.SIGN else slip.factor
    right = _test_signals(replace(recorded, load=load), columns, known)
    if right.slips or right.misfit is None or right.misfit > _AS_GOOD * (signals.misfit_explained or np.inf):
        return signals
    return replace(signals, slips=(slip,), rivals=(), misfit_explained=right.misfit)


def _with_first_slip(tested: RelationTest, slip: RecordSlip) -> RelationTest:
    """Return a test with one of its equally likely slips in first place."""
    if slip in tested.slips or abs(abs(np.log(slip.factor)) - abs(np.log(tested.slips[0].factor))) > _SAME_SIZE:
        return tested
    others = tuple(slip_or_rival for slip_or_rival in (*tested.slips, *tested.rivals) if slip_or_rival != slip)
    return replace(tested, slips=(slip,), rivals=others)


def _parts(steps: RecordedSteps, columns: Sequence[RecordedColumn], compliance: Array | None) -> list[RunPart]:
    """Return the parts of runs in another unit or with the opposite sign, from channels and signals together."""
    value = np.column_stack([steps.reading, steps.signal])
    answers = signal_tests.responses_of(SignalSteps(steps.load, steps.run, value, ()), len(columns))
    if compliance is not None:
        answers[: len(compliance)] = compliance
    return parts(steps.load, steps.run, value, columns, answers)


def _also_reversed(tested: RelationTest, steps: SignalSteps, table: str) -> RelationTest:
    """Return a test with rows that may be reversed as well, in runs of opposite sign with antisymmetric loads. Loads
    that are the same backwards never show a reversal."""
    turned = [slip for slip in tested.slips if slip.kind == SlipKind.SIGN]
    number = {name: run for run, name in enumerate(steps.runs)}
    rivals = list(tested.rivals)
    for slip in turned:
        named = [number[name] for name in slip.subjects if name in number]
        rows = np.isin(steps.run, named)
        if named and can_reverse(steps.load[rows], steps.run[rows])[1]:
            rivals.append(RecordSlip(SlipKind.REVERSED, table, tuple(steps.runs[run] for run in named)))
    if not tested.slips and can_reverse(steps.load, steps.run)[0]:
        return replace(tested, hidden=(*tested.hidden, RecordSlip(SlipKind.REVERSED, "rows")))
    return replace(tested, rivals=tuple(rivals))


def _test_readings(loaded: SignalSteps, known: KnownBench) -> RelationTest:
    alike = signal_tests.against_each_other(loaded, known.channels, READINGS)
    if known.compliance is not None:
        predicted = against_simulation(loaded, known.channels, known.compliance)
        return _or_stiffness(_prediction_or_run_test(predicted, alike, loaded.runs))
    return alike if alike.slips else against_range(loaded.load, known.largest) or alike


def _test_signals(recorded: SignalSteps, columns: Sequence[RecordedColumn], known: KnownBench) -> RelationTest:
    alike = signal_tests.against_each_other(recorded, columns, signal_tests.RELATION)
    if known.leg_forces is None:
        test = against_one_response(recorded, columns, alike.relation) if alike.state == _UNTESTED else None
        return alike if test is None else replace(test, hidden=alike.hidden)
    reported = signal_tests.against_geometry(recorded, columns, known.leg_forces, known.gain)
    if reported is None:
        return alike
    tested = _prediction_or_run_test(reported, alike, recorded.runs)
    return tested if known.gain is None else _or_sensitivity(tested)


def _prediction_or_run_test(predicted: RelationTest, alike: RelationTest, runs: Sequence[str]) -> RelationTest:
    """Return the test against a prediction, or between runs where the prediction finds no slip or only one of single
    runs."""
    of_runs = all(set(slip.subjects).intersection(runs) for slip in predicted.slips)
    if alike.slips and of_runs:
        return replace(alike, tried=predicted.tried + alike.tried)
    single = [slip for slip in alike.hidden if set(slip.subjects).intersection(runs) and slip.kind != SlipKind.SIGN]
    doubled = tuple(replace(slip, factor=0.5) if slip.kind == SlipKind.UNIT else slip for slip in single)
    return replace(predicted, tried=predicted.tried + alike.tried, hidden=(*predicted.hidden, *doubled))


def _or_sensitivity(tested: RelationTest) -> RelationTest:
    """Return a test with another explanation for a unit of all loads or all signals: a wrong declared sensitivity."""
    slip = tested.slips[0] if len(tested.slips) == 1 else None
    if slip is None or slip.subjects or slip.kind != SlipKind.UNIT or slip.quantity not in ("load", "signal"):
        return tested
    factor = slip.factor if slip.quantity == "load" else 1.0 / slip.factor
    return replace(tested, rivals=(*tested.rivals, RecordSlip(SlipKind.UNIT, "sensitivity_mv_per_n", (), factor)))


def _or_stiffness(tested: RelationTest) -> RelationTest:
    """Return a test with another explanation for a unit of all loads: the declared stiffness is off by the factor."""
    slip = tested.slips[0] if len(tested.slips) == 1 else None
    if slip is None or slip.subjects or slip.kind != SlipKind.UNIT or slip.quantity != "load":
        return tested
    stiffness = RecordSlip(SlipKind.UNIT, _STIFFNESS, (), 1.0 / slip.factor, dimension="stiffness")
    return replace(tested, rivals=(*tested.rivals, stiffness))


def _frozen_slips(
    constant: Sequence[Frozen], columns: Sequence[RecordedColumn], runs: Sequence[str]
) -> Iterator[RecordSlip]:
    """Return one slip for all runs in which the same columns of a quantity are constant."""
    by_run: dict[tuple[int, str], list[int]] = {}
    for one in constant:
        by_run.setdefault((one.run, columns[one.column].quantity), []).append(one.column)
    alike: dict[tuple[str, tuple[int, ...]], list[str]] = {}
    for (run, quantity), indices in by_run.items():
        alike.setdefault((quantity, tuple(indices)), []).append(runs[run])
    for (quantity, same), names in alike.items():
        every = len(same) == sum(column.quantity == quantity for column in columns)
        column_names = () if every and len(same) > 1 else tuple(columns[index].name for index in same)
        yield RecordSlip(SlipKind.FROZEN, quantity, (*column_names, *names))


def _values(steps: RecordedSteps, known: KnownBench) -> list[Values]:
    """Return the tables whose runs are compared, in the units of their files."""
    tables = list[Values]()
    is_observed = np.isfinite(steps.reading)
    if is_observed.any():
        reading, sigma = steps.reading / READING_SI, steps.sigma / READING_SI
        if is_observed.sum(axis=1).max() == 1:  # one channel at a time: a copy may have the name of another channel
            reading = np.where(is_observed, reading, 0.0).sum(axis=1, keepdims=True)
            reading[~is_observed.any(axis=1)] = np.nan
            sigma = np.where(is_observed, sigma, np.inf).min(axis=1, keepdims=True)
        tables.append(Values("readings", reading, _typical(sigma)))
    if steps.signals:
        hiss = np.full(len(steps.signals), known.signal_mv)
        tables.append(Values("signals", steps.signal / MILLIVOLT, hiss))
    return tables


def _typical(sigma: Array) -> Array:
    """Return the typical noise (K,) of columns (N, K); NaN where none is declared."""
    known = np.isfinite(sigma)
    return np.array(
        [np.median(column[there]) if there.any() else np.nan for column, there in zip(sigma.T, known.T, strict=True)]
    )
