"""Causes of an error that repeats along a joint: eccentricity, harmonics up to the mesh of gears, pitch of a screw."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.simulation.cause import Parameter, ReportedParameter
from truing.simulation.mechanisms.chains.causes import ChainScene, JointCause
from truing.simulation.mechanisms.chains.conditions import ChainInputs, usual_range

_PLAUSIBLE, _OF_GEARS = 5e-4, 5e-5  # rad: an error once per turn, and the least of any order
_OF_SCREWS, _MM = 2e-5, 1e-3  # m: an error of a screw, rack or scale
LOW, HIGHEST = (2, 3, 4, 5, 6, 7, 8), 200
# Fewest poses for a search above the low orders.
_FEWEST = 30
_SEARCHED = 2.0  # prior weight of all searched orders of a joint together, relative to a low one
# Fewest half periods over the range of the readings: of a low or known order, and of a searched one.
_HALVES, _HALVES_SEARCHED = 1.0, 4.0
# Range of a searched order about its candidate, in steps of the search.
_BESIDE = 0.75
# Waves count as equal at the readings if the sine of the angle between their spans is below this.
_ALIKE = 0.2
_VANISHING = 0.05  # a wave of this rms size at the readings shows nothing


@dataclass(frozen=True)
class TurningError(JointCause):
    """Base class of errors that repeat with the reading of a joint, of one that turns unless a class says otherwise.

    If ``aliased``, other orders give the same waves at the readings; the effect then ends with its campaign, because no
    other reading can be predicted.
    """

    aliased: bool = False

    reach = 10.0
    is_held_beyond = True

    @property
    def is_persistent(self) -> bool:
        """True if the order is determined."""
        return not self.aliased

    def applies(self, machine: ChainInputs) -> bool:
        """True if the joint turns."""
        return self.is_angle


@dataclass(frozen=True)
class JointEccentricity(TurningError):
    """A joint turns by sine x sin(q) + cosine x cos(q) more than it reads, once per turn."""

    id = "joint-eccentricity"

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return every revolute joint."""
        machine = scene.inputs_of_machine
        result: list[Self] = []
        for cause in super().candidates(scene):
            angle = machine.readings[:, machine.tree.readings.index(cause.joint)]
            result.append(replace(cause, aliased=_Waves.of(angle).is_open(0)))
        return result

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the two amplitudes."""
        return Parameter("sine", "rad", _PLAUSIBLE), Parameter("cosine", "rad", _PLAUSIBLE)

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return sine and cosine of the reading."""
        return _waves(machine.readings[:, reading], 1.0)


@dataclass(frozen=True)
class JointHarmonic(TurningError):
    """A joint turns by sine x sin(order q) + cosine x cos(order q) more than it reads: gears, bearings, encoders.

    A searched order lies within ``beside`` of ``order``; if ``free``, its distance is a further parameter, limited by a
    hyperbolic tangent.
    """

    order: float = 2
    beside: float = 0.0
    free: bool = False

    id = "joint-harmonic"

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return every revolute joint with every order that its readings distinguish, up to 200.

        Of orders with equal waves at the readings, as for a joint that stops in equal steps, only the lowest is a
        candidate. A joint with known orders of gears, even none, has these and the low ones.
        """
        machine = scene.inputs_of_machine
        result: list[Self] = []
        for cause in super().candidates(scene):
            angle = machine.readings[:, machine.tree.readings.index(cause.joint)]
            for order, beside, aliased in _orders(angle, LOW, machine.gear_orders.get(cause.joint)):
                result.append(replace(cause, order=order, beside=beside, aliased=aliased))
        return result

    def prior(self, scene: ChainScene) -> float:
        """Return the weight of the order: all searched ones of a joint together have that of two low ones."""
        return 1.0 if not self.beside else _SEARCHED * self.beside / (_BESIDE * HIGHEST)

    def refined(self) -> Self:
        """Return the form with a fitted order; unchanged if the order is known or ambiguous."""
        return replace(self, free=True) if self.beside and not self.aliased else self

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the two amplitudes, errors of higher orders being smaller; then the order's distance if it is free."""
        scale = max(_PLAUSIBLE / self.order, _OF_GEARS)
        waves = Parameter("sine", "rad", scale), Parameter("cosine", "rad", scale)
        return (*waves, Parameter("order_distance", "1", self.beside)) if self.free else waves

    def order_at(self, values: NDArray) -> float:
        """Return the order at values (P,) of the parameters."""
        return self.order + (self.beside * float(np.tanh(values[2] / self.beside)) if self.free else 0.0)

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return sine and cosine of the order times the reading."""
        return self._slopes(machine.readings[:, reading], np.zeros(2 + self.free))

    def deviation_slopes(self, machine: ChainInputs, values: NDArray) -> NDArray:
        """Return the derivatives of the deviations by the amplitudes and a free order."""
        reading = machine.tree.readings.index(self.joint)
        return machine.of_joint(reading, self._slopes(machine.readings[:, reading], values))

    def deviation(self, machine: ChainInputs, values: NDArray) -> NDArray:
        """Return the deviations at given amplitudes and order."""
        reading = machine.tree.readings.index(self.joint)
        motion = _waves(machine.readings[:, reading], self.order_at(values)) @ values[:2]
        return np.asarray(machine.of_joint(reading, motion[:, None])[..., 0])

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the amplitudes, and the order."""
        sigma = None
        if self.free:
            sigma = min(float(np.sqrt(covariance[2, 2])) / np.cosh(values[2] / self.beside) ** 2, self.beside)
        order = ReportedParameter("order", self.order_at(values), sigma, "1")
        return (*super().reported(values, covariance, legs)[:2], order)

    def _slopes(self, angle: NDArray, values: NDArray) -> NDArray:
        waves = _waves(angle, self.order_at(values))
        if not self.free:
            return waves
        by_phase = waves @ np.array([-values[1], values[0]])
        return np.column_stack([waves, angle * by_phase / np.cosh(values[2] / self.beside) ** 2])


@dataclass(frozen=True)
class JointPitchError(JointHarmonic):
    """A slide moves by sine x sin(order q) + cosine x cos(order q) more than it reads: screws, racks, scales.

    ``order`` is 2 pi over the period, rad/m.
    """

    id = "joint-pitch-error"

    def applies(self, machine: ChainInputs) -> bool:
        """True if the joint slides."""
        return not self.is_angle

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return every slide with its known periods or, where none are given, up to 200 periods over its travel."""
        machine = scene.inputs_of_machine
        result: list[Self] = []
        for cause in JointCause.candidates(self, scene):
            reading = machine.readings[:, machine.tree.readings.index(cause.joint)]
            unit, known = _once_over_travel(reading), machine.gear_orders.get(cause.joint)
            scaled = None if known is None else [order / unit for order in known]
            for order, beside, aliased in _orders(reading * unit, (), scaled):
                result.append(replace(cause, order=order * unit, beside=beside * unit, aliased=aliased))
        return result

    def prior(self, scene: ChainScene) -> float:
        """Return the weight of the period: all searched ones of a joint together have that of two known ones."""
        machine = scene.inputs_of_machine
        unit = _once_over_travel(machine.readings[:, machine.tree.readings.index(self.joint)])
        return 1.0 if not self.beside else _SEARCHED * self.beside / (_BESIDE * HIGHEST * unit)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the two amplitudes, then the distance of 2 pi over the period if it is free."""
        waves = Parameter("sine", "mm", _OF_SCREWS, _MM), Parameter("cosine", "mm", _OF_SCREWS, _MM)
        return (*waves, Parameter("order_distance", "1/m", self.beside)) if self.free else waves

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the amplitudes, and the period."""
        *waves, order = super().reported(values, covariance, legs)
        number = self.order_at(values)
        period = 2.0 * np.pi / number / _MM
        sigma = None if order.sigma is None else period * order.sigma / number
        return (*waves, ReportedParameter("period", period, sigma, "mm"))


def _once_over_travel(reading: NDArray) -> float:
    """Return 2 pi over the range of a slide's readings (B,), rad/m."""
    low, high = usual_range(reading)
    return 2.0 * np.pi / max(float(high - low), 1e-9)


def _waves(angle: NDArray, order: float) -> NDArray:
    return np.stack([np.sin(order * angle), np.cos(order * angle)], -1)


@dataclass(frozen=True)
class _Waves:
    """Orders (F,) of waves at the readings of a joint, from 1 on, and the mask (F, F) of indistinguishable ones beyond
    neighbours.

    ``shows`` (F,): waves that do not vanish at the readings. ``travel`` rad, ``step`` of the searched orders.
    """

    orders: NDArray
    same: Mask
    shows: Mask
    travel: float
    step: int

    @classmethod
    def of(cls, angle: NDArray, known: Sequence[float] = ()) -> Self:
        """Return the waves of the low, searched and known orders at readings (B,) that differ."""
        low, high = usual_range(angle)
        travel = max(float(high - low), 1e-9)
        step = max(1, min(HIGHEST, int(np.pi / travel)))
        orders = np.unique([1.0, *LOW, *range(LOW[-1] + 1, HIGHEST + 1, step), *known])
        alike = _same_waves(angle.tobytes(), orders.tobytes())
        same = alike & (np.abs(orders[:, None] - orders) > 2.0 * np.pi / travel)
        return cls(orders, same, alike.diagonal(), travel, step)

    def is_open(self, k: int) -> bool:
        """True if another order has the same wave."""
        return bool(self.same[k].any())


def _orders(angle: NDArray, low: Sequence[float], known: Sequence[float] | None) -> Iterator[tuple[float, float, bool]]:
    """Yield orders worth trying, the range of each about it (0 if exact), and whether the readings leave it open.

    ``low`` orders are always tried, as they are, ``known`` ones in place of a search.
    """
    waves = _Waves.of(angle, known or ())
    exact = {float(order) for order in (*low, *(known or ()))}
    for k, order in enumerate(map(float, waves.orders)):
        is_searched = order not in exact
        halves = _HALVES_SEARCHED if is_searched else _HALVES
        if order == 1.0 or not waves.shows[k] or waves.same[k, :k].any() or waves.travel * order < halves * np.pi:
            continue
        if is_searched and (known is not None or len(angle) < _FEWEST):
            continue
        yield order, _BESIDE * waves.step if is_searched else 0.0, waves.is_open(k)


@lru_cache(maxsize=64)
def _same_waves(readings: bytes, tested: bytes) -> Mask:
    """Return the mask (F, F) of orders (F,) whose waves at the readings (B,) of a joint are indistinguishable; an order
    without a wave equals none. Every round of a search asks again of the same numbers, given as their bytes."""
    angle, orders = np.frombuffer(readings), np.frombuffer(tested)
    waves = np.stack([_waves(angle, order) for order in orders])
    directions, sizes, _ = np.linalg.svd(waves - waves.mean(1, keepdims=True), full_matrices=False)
    spans: Array = directions * (sizes > _VANISHING * np.sqrt(len(angle)))[:, None]
    flat = np.moveaxis(spans, 1, 0).reshape(len(angle), -1)
    products = (flat.T @ flat).reshape(len(orders), 2, len(orders), 2)
    within, norm = np.sum(products**2, 3), np.sum(spans**2, 1)  # (F, 2, F), (F, 2)
    alike = (norm[:, :, None] - within < _ALIKE**2).all(1)
    return np.asarray(alike & norm.any(1)[:, None] & norm.any(1))
