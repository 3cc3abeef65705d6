"""Cause `JointSettling`: after a movement, a joint approaches its resting position exponentially."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, ReportedParameter
from truing.simulation.inputs import LAST_STEP, TIME, Missing
from truing.simulation.mechanisms.chains.causes import ChainScene, JointCause
from truing.simulation.mechanisms.chains.conditions import BETWEEN, SINCE_MOTION, ChainInputs

STEP_SHARE, SIDE = "share of the movement", "side of the movement"
_PLAUSIBLE_SHARE = 5e-4
# Time constants that are tried: the shortest and the longest over the range of the waits, and their ratio.
_SHORTEST, _LONGEST, _RATIO = 0.06, 1.0, 1.7
_PLAUSIBLE_LOG = 0.5  # prior sigma of the log of the time constant about that of the candidate
# Fewest poses that a candidate moves by more than this share of its largest deviation.
_FEWEST, _SEEN = 6, 0.2
_LEAST_RANGE = 0.3  # of the waits, relative to the longest


@dataclass(frozen=True)
class JointSettling(JointCause):
    """After a movement a joint deviates by -lag x exp(-(t - start_s) / tau), t seconds after it.

    The lag is a share of the movement, or has one size on either ``side`` of it (``form``). ``start_s`` is the shortest
    wait of the campaign. ``column``: the campaign's own column of waits; with ``time_s``, the joint counts as moved
    from the pose before, and a constant duration of the movements only changes the lag. If ``free``, the logarithm
    of tau over ``tau_s`` is a further parameter.
    """

    form: str = STEP_SHARE
    column: str = TIME
    start_s: float = 0.0
    tau_s: float = 1.0
    free: bool = False

    id = "joint-settling"
    reach = 10.0
    lacking = Missing.WAITS

    @property
    def family(self) -> str:
        """All forms of one joint."""
        return f"{self.id} {self.joint}"

    def candidates(self, scene: ChainScene) -> Sequence[Self]:
        """Return both forms and several time constants for every joint that waited for different times."""
        machine, result = scene.inputs_of_machine, list[Self]()
        covariates = machine.conditions.covariates
        column = SINCE_MOTION if SINCE_MOTION in covariates else TIME
        if LAST_STEP not in covariates or _waits(covariates, column, 0) is None:
            return result
        for cause in super().candidates(scene):
            reading = machine.tree.readings.index(cause.joint)
            waits = _waits(covariates, column, reading)
            joint_waits = waits[covariates[LAST_STEP][:, reading] != 0.0] if waits is not None else np.empty(0)
            if len(joint_waits) < _FEWEST or not np.isfinite(joint_waits).all() or not (joint_waits >= 0.0).all():
                continue
            start, longest = float(joint_waits.min()), float(joint_waits.max())
            for tau in _constants(joint_waits):
                bare = replace(cause, column=column, start_s=start, tau_s=tau)
                forms = [replace(bare, form=form) for form in (STEP_SHARE, SIDE)]
                result += [form for form in forms if longest > start and form._shows(machine, reading)]
        return result

    def refined(self) -> Self:
        """Return the form with a fitted time constant."""
        return replace(self, free=True)

    def with_fixed_shape(self, shape: NDArray) -> Self | None:
        """Return the form with a fixed time constant, from the logarithm of tau over tau_s."""
        return replace(self, tau_s=self.tau_s * float(np.exp(shape[0])), free=False)

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the column of waits, or the time."""
        return (self.column,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the lag, or its share of the movement; then the logarithm of the time constant if it is free."""
        size = Parameter("share", "1", _PLAUSIBLE_SHARE) if self.form == STEP_SHARE else self.size_named("lag")
        return (size, Parameter("log_tau", "1", _PLAUSIBLE_LOG)) if self.free else (size,)

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the lag at the shortest wait, the time constant, and that wait."""
        size = super().reported(values, covariance, legs)[0]
        spread = float(np.sqrt(covariance[1, 1])) if self.free else _PLAUSIBLE_LOG
        tau = self.tau_s * float(np.exp(values[1])) if self.free else self.tau_s
        after = ReportedParameter("shortest_wait", self.start_s, None, "s")
        return (size, ReportedParameter("tau", tau, tau * float(np.expm1(2.0 * spread)) / 2.0, "s"), after)

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return the deviation at the time constant of the candidate."""
        return self._slopes(machine, reading, np.zeros(1 + self.free))

    def deviation_slopes(self, machine: ChainInputs, values: NDArray) -> NDArray:
        """Return the derivatives of the deviations by the lag, and by the logarithm of a free time constant."""
        reading = machine.tree.readings.index(self.joint)
        return machine.of_joint(reading, self._slopes(machine, reading, values))

    def deviation(self, machine: ChainInputs, values: NDArray) -> NDArray:
        """Return the deviations at a lag and, if it is free, a time constant."""
        reading = machine.tree.readings.index(self.joint)
        course, _ = self._course(machine, reading, values)
        return np.asarray(machine.of_joint(reading, values[0] * course[:, None])[..., 0])

    def _slopes(self, machine: ChainInputs, reading: int, values: NDArray) -> NDArray:
        course, by_log = self._course(machine, reading, values)
        return np.stack([course, values[0] * by_log], -1) if self.free else course[:, None]

    def _course(self, machine: ChainInputs, reading: int, values: NDArray) -> tuple[NDArray, NDArray]:
        """Return the deviation (B,) per unit of the lag, and its derivative by the logarithm of the time constant."""
        covariates = machine.conditions.covariates
        waits = _waits(covariates, self.column, reading)
        step = covariates[LAST_STEP][:, reading]
        if waits is None:
            raise ValueError(f"{self.id} follows {self.column}, which these poses do not have")
        tau = self.tau_s * float(np.exp(values[1] if self.free else 0.0))
        passed = np.where(np.isfinite(waits), waits - self.start_s, 0.0) / tau
        size = np.where(np.isfinite(waits), step if self.form == STEP_SHARE else np.sign(step), 0.0)
        course = -size * np.exp(-passed)
        return course, course * passed

    def _shows(self, machine: ChainInputs, reading: int) -> bool:
        """True if enough poses show the deviation."""
        course = np.abs(self._course(machine, reading, np.zeros(1))[0])
        return bool((course > _SEEN * course.max(initial=0.0)).sum() >= _FEWEST)


def _waits(covariates: Mapping[str, NDArray], column: str, reading: int) -> NDArray | None:
    """Return the seconds (B,) since a joint's last movement; None if they are unknown."""
    if column == SINCE_MOTION:
        return covariates.get(SINCE_MOTION)
    found = covariates.get(BETWEEN)
    return None if found is None else found[:, reading]


def _constants(waits: NDArray) -> list[float]:
    """Return the time constants worth trying; none if the waits hardly differ."""
    extent = float(np.ptp(waits))
    if not extent > _LEAST_RANGE * float(waits.max()):
        return []
    count = 1 + int(np.ceil(np.log(_LONGEST / _SHORTEST) / np.log(_RATIO)))
    return [float(tau) for tau in extent * np.geomspace(_SHORTEST, _LONGEST, count)]
