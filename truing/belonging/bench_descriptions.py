"""Slips in the description of a bench: other legs than the declared ones predict its readings and signals."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array
from truing.belonging import signal_tests
from truing.belonging.load_tests import READINGS, KnownBench, by_compliance
from truing.belonging.plausible_slips import RecordedColumn
from truing.belonging.relation import SIGNAL_FACTORS, RecordSlip, RelationState, RelationTest
from truing.belonging.responses import responses
from truing.belonging.signal_tests import SignalSteps
from truing.belonging.slip_search import clear_responses, explain
from truing.estimation.interferometry.recorded_steps import RecordedSteps

# Share of the expected responses by which the declared legs miss at least, for another description to be sought; most
# that it may leave, of that and of the responses.
_CONTRADICTS, _EXPLAINED, _LEFT = 0.1, 0.2, 0.1


@dataclass(frozen=True)
class DescribedBench:
    """A description that a slip explains, and the compliance (K, 6) and leg forces (6, 6) by it; None where unknown.

    ``as_loads``: the slip of loads that signals alone cannot tell from it.
    """

    slip: RecordSlip
    as_loads: RecordSlip | None
    compliance: Array | None
    leg_forces: Array | None


@dataclass(frozen=True)
class _Misfit:
    """Rms misfit over rms expected response of readings and of signals; zero where there are none."""

    readings: float
    signals: float

    @property
    def worst(self) -> float:
        return max(self.readings, self.signals)


def with_described(
    tests: tuple[RelationTest, ...], steps: RecordedSteps, known: KnownBench, others: Iterable[DescribedBench]
) -> tuple[RelationTest, ...]:
    """Return the tests of readings and signals, with the slip of the description that explains what contradicts it.

    The declared legs must miss by a tenth at least, and others leave a fifth of that and a tenth of the responses at
    most: stiffnesses that are wrong by a tenth do neither.
    """
    declared = _misfit(steps, known)
    if declared.worst <= _CONTRADICTS:
        return tests
    found = list[tuple[_Misfit, DescribedBench]]()
    for other in others:
        if not _predicts_as_much(other, known):
            continue
        misfit = _misfit(steps, replace(known, compliance=other.compliance, leg_forces=other.leg_forces))
        if misfit.worst <= min(_EXPLAINED * declared.worst, _LEFT):
            found.append((misfit, other))
    if not found:
        return tests
    found.sort(key=lambda one: one[0].worst)
    best, right = found[0]
    rivals = [other.slip for misfit, other in found[1:] if misfit.worst <= 2.0 * best.worst]
    if right.as_loads is not None and not np.isfinite(steps.reading).any():
        rivals.append(right.as_loads)
    sizes = {READINGS: (declared.readings, best.readings), signal_tests.RELATION: (declared.signals, best.signals)}
    named = [
        RelationTest(
            relation,
            RelationState.FAILS,
            "slip",
            "",
            100.0 * before,
            100.0 * after,
            None,
            "%",
            (right.slip,),
            tuple(rivals),
        )
        for relation, (before, after) in sizes.items()
        if before > _CONTRADICTS
    ]
    named_relations = {test.relation for test in named}
    return (*named, *(test for test in tests if test.relation not in named_relations))


def _predicts_as_much(other: DescribedBench, known: KnownBench) -> bool:
    """Return True if a description predicts all that the declared one does: legs that move on may be singular."""
    loses_readings = known.compliance is not None and other.compliance is None
    return not loses_readings and (known.leg_forces is None or other.leg_forces is not None)


def _misfit(steps: RecordedSteps, known: KnownBench) -> _Misfit:
    readings = signals = 0.0
    if known.compliance is not None and np.isfinite(steps.reading).any():
        measured = clear_responses(responses(steps.load, steps.run, steps.reading), len(known.channels))
        if len(measured):
            readings = explain(measured, by_compliance(known.compliance), ()).before
    if known.leg_forces is not None and len(steps.signals) == len(known.leg_forces):
        columns = [RecordedColumn(name, "signal", SIGNAL_FACTORS) for name in steps.signals]
        recorded = SignalSteps(steps.load, steps.run, steps.signal, (), known.tared)
        signals = signal_tests.misfit_of_legs(recorded, columns, known.leg_forces, known.gain)
    return _Misfit(readings, signals)
