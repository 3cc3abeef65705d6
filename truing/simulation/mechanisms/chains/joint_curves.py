"""Class `JointErrorCurve`: a joint deviates from its reading by a curve that repeats: its encoder's scale, or its gear.

The curve consists of bumps of zero mean and zero slope: second differences of cubic splines. Their knots are equally
spaced over one turn, or over the travel of a joint that slides. Thus it can hardly imitate offsets, gains or errors of
low order, which are causes of their own. It returns to zero where no pose shows it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.mechanisms.chains.causes import ChainCause, ChainScene
from truing.simulation.mechanisms.chains.conditions import ChainInputs, usual_range
from truing.simulation.mechanisms.chains.nonparametric import NonparametricChainEffect

_TURN, _DEG, _MM = 2.0 * np.pi, np.pi / 180.0, 1e-3
_PLAUSIBLE_RAD, _PLAUSIBLE_M = 1e-4, 1e-5
# Knots over one turn, or over the travel of a joint that slides.
_KNOTS = (36, 72, 120)
# A curve has at least this many bumps that readings reach; fewer are no curve, but a polynomial. Poses and distinct
# readings for each of them, and most bumps of all joints together.
_FEWEST, _POSES_EACH, _READINGS_EACH, _MOST = 8, 4, 1.5, 450
# Knots that one bump reaches; so much of the period of a joint that slides lies beyond its travel.
_REACHED = 6
_PER_KNOT = 4  # values of a curve in tables
_PER_JOINT = "joints", "starts", "periods", "knots"
# The data determine a curve where its standard deviation is below this share of that without data.
DETERMINED = 0.5


def _motions_seen(scene: ChainScene) -> int:
    """Number of joint motions that one pose distinguishes, of two: all six coordinates of a link show two, one point or
    one distance shows one."""
    return 2 if len(scene.inputs_of_machine.channels.names) > 1 and not scene.distances else 1


@dataclass(frozen=True)
class JointCurve:
    """Curve of one joint at m readings, rad or m: its deviation, standard deviation, and whether data determine it."""

    joint: str
    is_angle: bool
    readings: Array
    deviation: Array
    sigma: Array
    is_determined: Mask


@dataclass(frozen=True)
class JointErrorCurve(ChainCause):
    """Joints deviate from their readings by repeatable curves: one joint, or all that turn, each with its own.

    ``starts`` and ``periods`` (J,) place the ``knots`` (J,) of each joint's curve, rad or m.
    """

    joints: tuple[str, ...] = ()
    starts: tuple[float, ...] = ()
    periods: tuple[float, ...] = ()
    knots: tuple[int, ...] = ()
    is_angle: bool = True

    id = "joint-error-curve"
    step = Step.DRIVE
    reach = 3.0

    @property
    def subject(self) -> str:
        """The joints."""
        return " ".join(f"joint {name}" for name in self.joints)

    @property
    def concerns_several(self) -> bool:
        """True if it holds curves of several joints."""
        return len(self.joints) > 1

    def excludes(self, other: ChainCause) -> bool:  # type: ignore[override]
        """True if the other one is a curve of a joint that has one here, or a nonparametric effect of its own reading:
        the two would cancel where poses were measured, and differ at other poses."""
        if isinstance(other, NonparametricChainEffect):
            return other.joint in self.joints and other.is_of_own_place
        return isinstance(other, JointErrorCurve) and not set(self.joints).isdisjoint(other.joints)

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return curves of every joint, and of all joints that turn, with knots as close as the poses determine."""
        machine = scene.inputs_of_machine
        result: list[Self] = []
        finest: dict[str, tuple[Self, int]] = {}
        for knots in _KNOTS:
            single = list(self._of_single_joints(machine, knots))
            result += [curve for curve, _ in single]
            before = dict(finest)
            finest |= {curve.joints[0]: (curve, reached) for curve, reached in single if curve.is_angle}
            turning = [finest[joint] for joint in machine.tree.readings if joint in finest]
            total = sum(reached for _, reached in turning)
            curves = [curve for curve, _ in turning]
            is_determined = _POSES_EACH * total <= _motions_seen(scene) * len(machine.readings)
            if finest != before and len(curves) > 1 and is_determined and sum(c.knots[0] for c in curves) <= _MOST:
                result.append(self._of(curves))
        return result

    def _of(self, curves: Sequence[Self]) -> Self:
        """Return the cause that holds the curves of several joints."""
        joined = {name: sum((getattr(curve, name) for curve in curves), ()) for name in _PER_JOINT}
        return replace(self, is_angle=curves[0].is_angle, **joined)

    def _of_single_joints(self, machine: ChainInputs, knots: int) -> Iterator[tuple[Self, int]]:
        """Yield the curve of every joint whose readings determine it, and the number of knots that they reach."""
        for k, name in enumerate(machine.tree.readings):
            readings, turns = machine.readings[:, k], bool(machine.tree.is_revolute[k])
            low, high = (0.0, _TURN) if turns else usual_range(readings)
            if not high > low:
                continue
            period = float(high - low) * (1.0 if turns else knots / (knots - _REACHED))
            ends = {"starts": (float(low),), "periods": (period,)}
            curve = replace(self, joints=(name,), knots=(knots,), is_angle=turns, **ends)
            coordinate = curve._in_knots(readings, 0)
            reached, distinct = (len(np.unique(np.floor(coordinate * cells))) for cells in (1, 2))
            if reached >= _FEWEST and len(readings) >= _POSES_EACH * reached and distinct >= _READINGS_EACH * reached:
                yield curve, reached

    def _in_knots(self, readings: NDArray, index: int) -> Array:
        """Return readings (B,) of one joint in knots from the start: within a turn, or held at the ends of a travel."""
        knots = self.knots[index]
        x = (readings - self.starts[index]) * (knots / self.periods[index])
        return np.asarray(x % knots if self.is_angle else np.clip(x, 0.0, knots - _REACHED))

    def basis(self, readings: NDArray, index: int) -> Array:
        """Return the bumps (B, m) of one joint's curve at its readings (B,)."""
        knots, heights = self._bumps(readings, index)
        result = np.zeros((len(readings), self.knots[index]))
        np.put_along_axis(result, knots, heights, 1)
        return result

    def _bumps(self, readings: NDArray, index: int) -> tuple[Index, Array]:
        """Return knots (B, 6) whose bumps differ from zero at readings (B,) of one joint, and their values there."""
        x = self._in_knots(readings, index)
        first = np.floor(x).astype(int)
        t = x - first
        splines = np.zeros((len(x), _REACHED + 2))  # of the knots around, with zeros at the ends
        weights = ((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3)
        splines[:, 2:-2] = np.stack(weights, -1) / 6.0
        around = np.arange(_REACHED) - 2
        heights = 2.0 * splines[:, 1:-1] - splines[:, :-2] - splines[:, 2:]
        return (first[:, None] + around) % self.knots[index], heights

    def deviations(self, machine: ChainInputs) -> NDArray:
        """Return the deviations (B, n, P) of the joints per unit of the parameters."""
        result = np.zeros((len(machine.readings), len(machine.tree.readings), sum(self.knots)))
        for index, joint in enumerate(self.joints):
            reading = machine.tree.readings.index(joint)
            result[:, reading, self._rows_of(index)] = self.basis(machine.readings[:, reading], index)
        return result

    def deviation(self, machine: ChainInputs, values: NDArray) -> NDArray:
        """Return the deviations (B, n) of the joints at values (P,), SI."""
        result = np.zeros((len(machine.readings), len(machine.tree.readings)))
        for index, joint in enumerate(self.joints):
            reading = machine.tree.readings.index(joint)
            knots, heights = self._bumps(machine.readings[:, reading], index)
            result[:, reading] = np.sum(heights * values[self._rows_of(index)][knots], -1)
        return result

    def joint_motion(self, machine: ChainInputs, values: NDArray, by_joint: NDArray) -> NDArray:
        """Return the derivatives (B, 3 K, P) of channels; only six bumps of each joint act in a pose."""
        rows = by_joint.reshape(len(by_joint), -1, by_joint.shape[-1])
        result = np.zeros((*rows.shape[:2], sum(self.knots)))
        for index, joint in enumerate(self.joints):
            reading = machine.tree.readings.index(joint)
            knots, heights = self._bumps(machine.readings[:, reading], index)
            by_height = rows[:, :, reading, None] * heights[:, None]
            np.put_along_axis(result[..., self._rows_of(index)], knots[:, None], by_height, 2)
        return result

    def curves(self, values: NDArray, covariance: NDArray) -> Iterator[JointCurve]:
        """Yield the curve of every joint, from all parameters (P,) and their covariance (P, P), SI."""
        for index, joint in enumerate(self.joints):
            rows = self._rows_of(index)
            knots = self.knots[index]
            span = knots if self.is_angle else knots - _REACHED
            steps = np.arange(span * _PER_KNOT + (not self.is_angle)) / _PER_KNOT
            readings = self.starts[index] + self.periods[index] / knots * steps
            basis = self.basis(readings, index)
            variance = np.sum((basis @ covariance[rows, rows]) * basis, -1)
            free = self.reach * self._size[1] * np.sqrt(np.sum(basis**2, -1))
            sigma = np.sqrt(np.maximum(variance, 0.0))
            yield JointCurve(joint, self.is_angle, readings, basis @ values[rows], sigma, sigma < DETERMINED * free)

    def _rows_of(self, index: int) -> slice:
        """Return the places of one joint's parameters."""
        return slice(sum(self.knots[:index]), sum(self.knots[: index + 1]))

    @property
    def _size(self) -> tuple[str, float, float]:
        """Unit, plausible size and SI value of the unit."""
        return ("rad", _PLAUSIBLE_RAD, 1.0) if self.is_angle else ("mm", _PLAUSIBLE_M, _MM)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the height of every bump of every joint."""
        ends = [f"_{joint}" if self.concerns_several else "" for joint in self.joints]
        return tuple(
            Parameter(f"bump_{k}{end}", *self._size) for end, n in zip(ends, self.knots, strict=True) for k in range(n)
        )

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the largest deviation of every curve where data determine it, and the largest distance of knots."""
        unit, _, si = self._size
        found = []
        for curve in self.curves(values, covariance):
            if curve.is_determined.any():
                k = int(np.argmax(np.abs(curve.deviation) * curve.is_determined))
                name = f"largest_{curve.joint}" if self.concerns_several else "largest"
                found.append(ReportedParameter(name, abs(curve.deviation[k]) / si, curve.sigma[k] / si, unit))
        step = max(period / knots for period, knots in zip(self.periods, self.knots, strict=True))
        spacing = (step / _DEG, None, "deg") if self.is_angle else (step / _MM, None, "mm")
        return (*found, ReportedParameter("spacing", *spacing))
