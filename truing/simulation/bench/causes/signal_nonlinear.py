"""Cause: nonlinear signals, by their own square and cube, or by squares and products of loads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.reading_causes import (
    MV,
    BenchScene,
    ReadingCause,
    channel_subject,
    is_signal,
    read_channels,
)
from truing.simulation.bench.load_steps import LoadSteps, ReadingState
from truing.simulation.bench.six_upur.loading import AXES
from truing.simulation.cause import Parameter, Step

QUADRATIC, CUBIC = "quadratic", "cubic"
_POWERS = {QUADRATIC: 2, CUBIC: 3}
_PLAUSIBLE = 0.02  # share of the largest signal
# Largest number of parameters of a form, and least number of readings per parameter.
_MOST_PARAMETERS, _ROWS_PER_PARAMETER = 60, 3
_ALL_SHARE = 0.5
# Products of loads below this are rounding.
_NOTHING = 1e-9


@dataclass(frozen=True)
class SignalNonlinear(ReadingCause):
    """A ``signal`` with additional terms: ``powers`` of itself, or products of ``loads``.

    ``full_scale`` (V) is the largest value of each signal. ``loads`` are products of two or three loads over their
    largest (``fx-fx`` is a square). ``signal`` is empty for all of ``signals``, each with its own parameters.
    """

    signal: str = "v1"
    powers: tuple[str, ...] = (QUADRATIC,)
    loads: tuple[str, ...] = ()
    signals: tuple[str, ...] = ("v1",)
    full_scale: tuple[float, ...] = (1.0,)

    id = "signal-nonlinear"
    step = Step.INSTRUMENT
    reach = 100.0

    @property
    def subject(self) -> str:
        """Signal, or ``signals`` for all."""
        return channel_subject(self.signal) or "signals"

    @property
    def key(self) -> str:
        """Unique name of the candidate."""
        return f"{self.family} {' '.join(self.powers + self.loads)}"

    @property
    def family(self) -> str:
        """Kind and signal."""
        return f"{self.id} {self.signal}".strip()

    def excludes(self, other: ReadingCause) -> bool:
        """True if the other cause is of the same kind and shares a signal with this one."""
        if not isinstance(other, SignalNonlinear):
            return False
        return not self.signal or not other.signal or self.signal == other.signal

    def candidates(self, scene: BenchScene) -> Sequence[SignalNonlinear]:
        """Return every signal, and all, with square, cube or both, and with squares, products and cubes of loads."""
        steps = scene.steps
        signals = [name for name in steps.channels if is_signal(name)]
        size = dict(zip(signals, np.abs(steps.signals).max(0, initial=0.0).tolist(), strict=True))
        names = [name for name in read_channels(scene) if size.get(name, 0.0) > 0.0]
        if not names or not _has_levels(steps):
            return ()
        squares = _products(steps)
        own_powers: tuple[tuple[str, ...], ...] = ((QUADRATIC,), (CUBIC,), (QUADRATIC, CUBIC))
        forms: list[tuple[tuple[str, ...], tuple[str, ...]]] = [(powers, ()) for powers in own_powers]
        forms += [((), squares), ((), squares + _cubes(steps))]
        chosen = [(name, (name,)) for name in names] + ([("", tuple(names))] if len(names) > 1 else [])
        candidates_of_signals = [
            SignalNonlinear(signal, powers, loads, signals_of_form, tuple(size[name] for name in signals_of_form))
            for signal, signals_of_form in chosen
            for powers, loads in forms
        ]
        return [
            candidate
            for candidate in candidates_of_signals
            if candidate.size <= min(_MOST_PARAMETERS, _reading_count(scene, candidate) // _ROWS_PER_PARAMETER)
        ]

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.signals) * (len(self.powers) + len(self.loads))

    def prior(self, scene: BenchScene) -> float:
        """Return the relative prior weight of a signal, or of all together."""
        return 1.0 if self.signal else _ALL_SHARE * sum(map(is_signal, read_channels(scene)))

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the powers, then the products of loads over their largest, for each signal."""
        parameters: list[Parameter] = []
        for name, scale in zip(self.signals, self.full_scale, strict=True):
            ending = "" if self.signal else f"_{name}"
            for power, unit in self._units:
                si = MV ** (1 - _POWERS[power])
                parameters.append(Parameter(f"{power}{ending}", unit, _PLAUSIBLE * scale ** (1 - _POWERS[power]), si))
            terms = [term.replace("-", "_") for term in self.loads]
            parameters += [Parameter(f"{term}{ending}", "mV", _PLAUSIBLE * scale, MV) for term in terms]
        return tuple(parameters)

    @property
    def _units(self) -> list[tuple[str, str]]:
        return [(power, "1/mV" if power == QUADRATIC else "1/mV^2") for power in self.powers]

    def slopes(self, state: ReadingState, values: NDArray) -> NDArray:
        """Return d readings / d parameters."""
        names = state.steps.channels
        by_loads = np.stack([_product(state.steps, term) for term in self.loads], -1) if self.loads else None
        each = len(self.powers) + len(self.loads)
        derivative = np.zeros((*state.readings.shape, each * len(self.signals)), np.result_type(state.readings, values))
        for index, name in enumerate(self.signals):
            if name not in names:
                continue
            channel, first = names.index(name), each * index
            for n, power in enumerate(self.powers):
                derivative[:, channel, first + n] = state.readings[:, channel] ** _POWERS[power]
            if by_loads is not None:
                derivative[:, channel, first + len(self.powers) : first + each] = by_loads
        return derivative

    def passed_on(self, slopes: NDArray, state: ReadingState, values: NDArray) -> NDArray:
        """Return changes of the readings, times the slopes of the signals' curves."""
        carried = np.array(slopes, np.result_type(slopes, state.readings, values))
        each, names = len(self.powers) + len(self.loads), state.steps.channels
        for index, name in enumerate(self.signals):
            if name not in names:
                continue
            channel = names.index(name)
            for n, power in enumerate(self.powers):
                steep = _POWERS[power] * state.readings[:, channel] ** (_POWERS[power] - 1)
                carried[:, channel] += values[each * index + n] * steep[:, None] * slopes[:, channel]
        return carried


def _reading_count(scene: BenchScene, cause: SignalNonlinear) -> int:
    return int(scene.recorded[:, [name in cause.signals for name in scene.steps.channels]].sum())


def _has_levels(steps: LoadSteps) -> bool:
    """True if some axis was loaded by several amounts, which a square needs to differ from a slope."""
    return any(len(np.unique(np.round(share_of_axis, 9))) > _POWERS[QUADRATIC] for share_of_axis in steps.share.T)


def _products(steps: LoadSteps) -> tuple[str, ...]:
    """Return the nonzero products of two loads, including squares."""
    terms = ["-".join(chosen) for chosen in combinations_with_replacement(_loaded(steps), _POWERS[QUADRATIC])]
    return tuple(term for term in terms if np.any(np.abs(_product(steps, term)) > _NOTHING))


def _cubes(steps: LoadSteps) -> tuple[str, ...]:
    return tuple("-".join([axis] * _POWERS[CUBIC]) for axis in _loaded(steps))


def _loaded(steps: LoadSteps) -> list[str]:
    return [axis for axis, loaded in zip(AXES, steps.loaded, strict=True) if loaded]


def _product(steps: LoadSteps, term: str) -> NDArray:
    """Return a product (B,) of loads, as shares of their largest."""
    return np.asarray(np.prod(steps.share[:, [AXES.index(axis) for axis in term.split("-")]], axis=1))
