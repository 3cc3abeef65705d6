"""Cause: targets that sag with the direction of gravity in the frame of their body, as on soft holders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bodies.causes.deformation import BodyCause, bodies_of, is_large
from truing.simulation.cause import Parameter, ReportedParameter
from truing.simulation.change import Change
from truing.simulation.inputs import Missing, gravity_column
from truing.simulation.mechanisms.point_causes import PointScene
from truing.simulation.mechanisms.state import State

ALONG, FREE = "along", "free"
_MM = 1e-3
# Plausible sag of a target, relative to its distance from the body's centre.
_PLAUSIBLE = 1e-4
# Least turn of the direction of gravity in a body's frame, rad, for a sag to be observable.
_LEAST_TURN = 0.1
_SHARES = {ALONG: 0.4, FREE: 0.2}
_SHARE_OF_ONE = 0.4


@dataclass(frozen=True)
class GravitySag(BodyCause):
    """A body's targets shift with the direction of gravity in its frame, relative to its mean over the campaign.

    Each target has its own ``sag`` along gravity, without their common part, or, if ``free``, a shift in any direction
    per component of gravity; or only target ``one`` sags. ``middle`` is the mean direction. The platform of a
    mechanism, whose pose follows from the readings, may have a common sag but no ``free`` form; ``up`` is then a unit
    vector of the base frame. If ``up`` is empty, a column holds the direction of gravity.
    """

    form: str = ALONG
    one: str = ""
    middle: tuple[float, ...] = (0.0, 0.0, 0.0)
    up: tuple[float, ...] = ()

    id = "gravity-sag"
    lacking = Missing.UP
    reads = frozenset({"pose"})

    def missing_input(self, scene: PointScene) -> Missing | None:
        """Return the missing input: the direction of gravity, or for a mechanism tilts of its platform."""
        return Missing.TILT if scene.legs else self.lacking

    @property
    def key(self) -> str:
        """Unique name of the candidate."""
        return f"{self.id} {self.body} {self.form} {self.one}".strip()

    @property
    def family(self) -> str:
        """Body: its forms exclude each other."""
        return f"{self.id} {self.body}"

    @property
    def subject(self) -> str:
        """Target that sags alone, or the body."""
        return f"target {self.one}" if self.one else self.body

    def candidates(self, scene: PointScene) -> Sequence[GravitySag]:
        """Return every body in whose frame gravity turns, as a whole, and each of its targets."""
        sags = []
        for body, targets, positions in bodies_of(scene):
            down = scene.covariates.get(gravity_column(body))
            if down is None or np.ptp(down, axis=0).max() < _LEAST_TURN:
                continue
            middle, up = np.mean(down, axis=0).tolist(), () if scene.weight is None else scene.weight.up
            sag = GravitySag(body, targets, positions, middle=tuple(middle), up=up)
            sags += [sag._with_form(form) for form in (ALONG, *(() if is_large(targets) or up else (FREE,)))]
            sags += [sag._with_form(ALONG, target) for target in targets]
        return sags

    def _with_form(self, form: str, target: str = "") -> GravitySag:
        return replace(self, form=form, one=target)

    def prior(self, scene: PointScene) -> float:
        """Return the share of this form: a single soft holder is as probable as individual sags of all."""
        return _SHARE_OF_ONE / len(self.targets) if self.one else _SHARES[self.form]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the sag of each target, or of one, for unit change of the direction of gravity.

        For the free form, return the shift along each axis per component of the direction.
        """
        if self.form == FREE:
            return tuple(parameter for axis in "xyz" for parameter in self._pattern_parameters(f"_g{axis}"))
        scale = _PLAUSIBLE * self._radius
        return tuple(Parameter(f"{name}_sag", "mm", scale, _MM) for name in ((self.one,) if self.one else self.targets))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d moved / d sag: the direction of gravity in the body's frame; empty if that is unknown."""
        size = len(self.parameters(0))
        down = self._gravity_direction(state)
        if down is None or state.targets is None:
            return Change({}, size)
        away = down - np.array(self.middle)
        if self.form == FREE:
            return Change({"moved": self._derivative_of_moved(state, away)}, size)
        known = tuple(zip(state.targets.bodies, state.targets.names, strict=True))
        shares = np.zeros((len(known), size))
        for row, target in enumerate(self.targets):
            if (self.body, target) in known:
                shares[known.index((self.body, target))] = self._shares[row]
        return Change({"moved": away[:, None, :, None] * shares[:, None]}, size)

    def _gravity_direction(self, state: State) -> NDArray | None:
        """Return the direction of gravity (B, 3) in the body's frame; None if it is unknown."""
        if self.up:
            return np.asarray(-np.array(self.up) @ state.R) if len(state.R) else None
        found = state.covariates.get(gravity_column(self.body))
        return None if found is None else np.asarray(found)

    @property
    def _shares(self) -> NDArray:
        """Derivative (k, P) of each target's shift by the sags; a common sag of a free body is part of its pose."""
        count = len(self.targets)
        if self.one:
            return (np.array(self.targets) == self.one).astype(float)[:, None]
        return np.eye(count) if self.up else np.eye(count) - 1.0 / count

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the sags, without their rigid motion of the body."""
        if self.form == FREE:
            return super().reported(*self._free_of_motion(values, covariance), legs)
        shares = np.eye(1) if self.one else self._shares
        return super().reported(shares @ values, shares @ covariance @ shares.T, legs)
