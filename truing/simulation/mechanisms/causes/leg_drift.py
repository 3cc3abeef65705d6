"""Cause: drift of the effective leg lengths with time, linear or exponentially settling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.change import Change
from truing.simulation.inputs import TIME, Missing
from truing.simulation.mechanisms.causes.per_leg import PerLeg, choice_share, choices
from truing.simulation.mechanisms.point_causes import PointScene
from truing.simulation.mechanisms.state import State
from truing.simulation.settling import reported_time_constant, settling

_PLAUSIBLE_M = 7e-6
# Time constants of the candidates, relative to the duration; neighbours give nearly the same course.
_SETTLING = (1.0, 0.5, 0.25, 0.125, 0.0625)
# Prior sigma of the log of the time constant about that of the candidate.
_PLAUSIBLE_LOG = 0.5
_EVEN_SHARE = 0.5


@dataclass(frozen=True)
class LegDrift(PerLeg):
    """The effective length of legs changes by drift from the first pose to the last, linearly or as 1 - exp(-t / tau).

    ``start_s`` is the time of the first pose and ``duration_s`` the time from the first to the last, over the whole
    campaign; ``tau_s`` is 0 for a linear drift. If ``free``, the logarithm of tau over ``tau_s`` is a further
    parameter.
    """

    start_s: float = 0.0
    duration_s: float = 1.0
    tau_s: float = 0.0
    free: bool = False

    id = "leg-drift"
    lacking = Missing.TIME
    step = Step.STRUCTURE
    is_persistent = False
    reads = frozenset()

    def candidates(self, scene: PointScene) -> Sequence[LegDrift]:
        """Return a linear drift and several time constants for every choice of legs; none if times are unknown."""
        if scene.span_s is None or not scene.varies(TIME) or not np.isfinite(scene.covariates[TIME]).all():
            return ()
        start, duration = scene.span_s[0], scene.span_s[1] - scene.span_s[0]
        constants = (0.0, *(share * duration for share in _SETTLING))
        return [LegDrift(chosen, start, duration, tau) for tau in constants for chosen in choices(scene.legs)]

    def prior(self, scene: PointScene) -> float:
        """Return the share of this choice of legs and course: linear drifts have half of the probability."""
        course = _EVEN_SHARE if self.tau_s == 0 else (1 - _EVEN_SHARE) / len(_SETTLING)
        return course * choice_share(len(self.legs), scene.legs)

    def refined(self) -> Self:
        """Return the form with a fitted time constant; unchanged if the drift is linear."""
        return self if self.tau_s == 0 else replace(self, free=True)

    def like_sized(self, legs: int) -> tuple[int, ...]:
        """Return the drifts of the legs concerned."""
        return tuple(range(len(self.leg_numbers(legs))))

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the time."""
        return (TIME,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the drift of each leg concerned, then the logarithm of the time constant if it is free."""
        drifts = tuple(Parameter(name, "mm", _PLAUSIBLE_M, 1e-3) for name in self.numbered("drift", legs))
        return (*drifts, Parameter("log_tau", "1", _PLAUSIBLE_LOG)) if self.free else drifts

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the drifts, then tau in s if the drift settles."""
        reported_values = super().reported(values, covariance, legs)
        if self.tau_s == 0:
            return reported_values
        if not self.free:
            return (*reported_values, ReportedParameter("tau", self.tau_s, None, "s"))
        return (*reported_values[:-1], reported_time_constant(self.tau_s, values[-1], covariance[-1, -1]))

    def change(self, state: State, values: NDArray) -> Change:
        """Return the derivatives of the leg lengths by the drift of each leg concerned, and by the log of the time
        constant."""
        course, slope = self._course(state.covariates[TIME], values)
        columns = self._columns(course, state.legs.count)
        if self.free:
            bent = self._columns(slope, state.legs.count) @ values[:-1]
            columns = np.concatenate([columns, bent[..., None]], -1)
        return Change({"l": columns}, columns.shape[-1])

    def shift(self, state: State, values: NDArray) -> dict[str, NDArray]:
        """Return the elongation of the legs, m."""
        course, _ = self._course(state.covariates[TIME], values)
        return {"l": self._columns(course, state.legs.count) @ (values[:-1] if self.free else values)}

    def _columns(self, course: NDArray, legs: int) -> NDArray:
        return self.spread(np.broadcast_to(course[:, None], (len(course), legs)))

    def _course(self, time: NDArray, values: NDArray) -> tuple[NDArray, NDArray]:
        """Return the course (B,), 0 at the first pose and 1 at the last, and its derivative by the log of tau."""
        passed = (time - self.start_s) / self.duration_s
        if self.tau_s == 0:
            return passed, np.zeros_like(passed)
        rate = self.duration_s / self.tau_s * np.exp(-values[-1] if self.free else 0.0)
        return settling(passed, rate)
