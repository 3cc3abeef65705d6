"""Targets that sag: they shift on their body with the direction of gravity in its frame, as soft holders do."""

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
# A plausible sag of a target over its distance from the middle of the body.
_PLAUSIBLE = 1e-4
# The direction of gravity has to turn by this much in a body's frame, rad, to show anything.
_LEAST_TURN = 0.1
_SHARES = {ALONG: 0.4, FREE: 0.2}
_SHARE_OF_ONE = 0.4


@dataclass(frozen=True)
class GravitySag(BodyCause):
    """A body's targets shift with the direction of gravity in its frame, counted from its mean over the campaign.

    Each along gravity by its own ``sag``, beyond what all do, or, ``free``, in any direction by each component of it;
    or the target ``one`` alone. ``middle`` is the mean direction. Of a mechanism's platform, whose pose follows from
    the readings, all may do so alike, and there is no ``free`` form; ``up`` is a unit vector of the base frame. Without
    ``up`` a column holds the direction of gravity.
    """

    form: str = ALONG
    one: str = ""
    middle: tuple[float, ...] = (0.0, 0.0, 0.0)
    up: tuple[float, ...] = ()

    id = "gravity-sag"
    lacking = Missing.UP
    reads = frozenset({"pose"})

    def lacks(self, scene: PointScene) -> Missing | None:
        """What was not recorded: the direction of gravity, of a mechanism also tilts of its platform."""
        return Missing.TILT if scene.legs else self.lacking

    @property
    def key(self) -> str:
        """Return the name that tells this candidate from all others."""
        return f"{self.id} {self.body} {self.form} {self.one}".strip()

    @property
    def family(self) -> str:
        """Return the body: its forms exclude each other."""
        return f"{self.id} {self.body}"

    @property
    def subject(self) -> str:
        """Return the target that sags alone, or the body."""
        return f"target {self.one}" if self.one else self.body

    def candidates(self, scene: PointScene) -> Sequence[GravitySag]:
        """Return every body in whose frame gravity turns, as a whole, and each of its targets."""
        found = []
        for body, targets, places in bodies_of(scene):
            down = scene.covariates.get(gravity_column(body))
            if down is None or np.ptp(down, axis=0).max() < _LEAST_TURN:
                continue
            middle, up = np.mean(down, axis=0).tolist(), () if scene.weight is None else scene.weight.up
            own = GravitySag(body, targets, places, middle=tuple(middle), up=up)
            found += [own._as(form) for form in (ALONG, *(() if is_large(targets) or up else (FREE,)))]
            found += [own._as(ALONG, target) for target in targets]
        return found

    def _as(self, form: str, one: str = "") -> GravitySag:
        return replace(self, form=form, one=one)

    def prior(self, scene: PointScene) -> float:
        """Return the share of this form: a single soft holder is as likely as all of them, each by its own."""
        return _SHARE_OF_ONE / len(self.targets) if self.one else _SHARES[self.form]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the sag of each target, or of one, as gravity turns from across to along; of a free form the shift
        along each axis by each component of the direction."""
        if self.form == FREE:
            return tuple(parameter for axis in "xyz" for parameter in self._of_pattern(f"_g{axis}"))
        scale = _PLAUSIBLE * self._radius
        return tuple(Parameter(f"{name}_sag", "mm", scale, _MM) for name in ((self.one,) if self.one else self.targets))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d moved / d sag: the direction of gravity in the body's frame; nothing where that is not known."""
        size = len(self.parameters(0))
        down = self._down(state)
        if down is None or state.targets is None:
            return Change({}, size)
        away = down - np.array(self.middle)
        if self.form == FREE:
            return Change({"moved": self._moved(state, away)}, size)
        known = tuple(zip(state.targets.bodies, state.targets.names, strict=True))
        shares = np.zeros((len(known), size))
        for row, target in enumerate(self.targets):
            if (self.body, target) in known:
                shares[known.index((self.body, target))] = self._shares[row]
        return Change({"moved": away[:, None, :, None] * shares[:, None]}, size)

    def _down(self, state: State) -> NDArray | None:
        """Return the direction of gravity (B, 3) in the body's frame; None where that is not known."""
        if self.up:
            return np.asarray(-np.array(self.up) @ state.R) if len(state.R) else None
        found = state.covariates.get(gravity_column(self.body))
        return None if found is None else np.asarray(found)

    @property
    def _shares(self) -> NDArray:
        """Return how far each target (k, P) sags: what all of a free body have in common is its pose."""
        count = len(self.targets)
        if self.one:
            return (np.array(self.targets) == self.one).astype(float)[:, None]
        return np.eye(count) if self.up else np.eye(count) - 1.0 / count

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the sags, without what is a motion of the body as a whole."""
        if self.form == FREE:
            return super().reported(*self._free_of_motion(values, covariance), legs)
        own = np.eye(1) if self.one else self._shares
        return super().reported(own @ values, own @ covariance @ own.T, legs)
