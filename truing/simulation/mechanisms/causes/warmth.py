"""Causes: thermal expansion of the whole machine, of its legs, or of bodies without a mechanism."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, Step
from truing.simulation.change import Change
from truing.simulation.inputs import Missing
from truing.simulation.mechanisms.causes.per_leg import SharedOrPerLeg
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State

if TYPE_CHECKING:
    from truing.simulation.targets import Targets

TEMPERATURE = "temperature_c"
COMMON, APART, BODIES = "common", "apart", "bodies"
# Expansion per kelvin: steel 12e-6, aluminium 23e-6, carbon fibre nearly 0.
_PLAUSIBLE = 1e-5
_PARTS = ("base", "platform", "legs")
_SHARE = {COMMON: 0.6, APART: 0.4}
# Prior probability for bodies without a mechanism: all of them, or a single one.
_SHARE_OF_ALL, _SHARE_OF_ONE = 0.5, 0.5


@dataclass(frozen=True)
class ThermalExpansion(PointCause):
    """Base and platform expand about their origins, legs in length, by alpha times the temperature above the reference.

    ``form``: one alpha for all three parts, or one each (``apart``). Without a mechanism, all ``bodies``, or only
    ``body``, expand about the origins of their surveys.
    """

    form: str = COMMON
    body: str = ""

    id = "thermal-expansion"
    lacking = Missing.TEMPERATURE
    step = Step.STRUCTURE
    reads = frozenset({"a", "b", "l", "shape"})
    has_known_scale = True

    @property
    def subject(self) -> str:
        """Body that expands alone; empty for all."""
        return self.body

    def candidates(self, scene: PointScene) -> Sequence[ThermalExpansion]:
        """Return both forms if the temperature departs from the reference; without legs, all bodies and each single
        body."""
        if not warms(scene):
            return ()
        if scene.legs:
            return [ThermalExpansion(form) for form in (COMMON, APART)]
        names = tuple(dict.fromkeys(scene.targets.bodies))
        return [ThermalExpansion(BODIES, body) for body in ("", *(names if len(names) > 1 else ()))]

    def prior(self, scene: PointScene) -> float:
        """Return the share of this form: one parameter is more probable than three, all bodies than one particular
        body."""
        if scene.legs:
            return _SHARE[self.form]
        return _SHARE_OF_ONE / len(set(scene.targets.bodies)) if self.body else _SHARE_OF_ALL

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the temperature."""
        return (TEMPERATURE,)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return alpha, or alpha_base, alpha_platform and alpha_legs."""
        names = [f"alpha_{part}" for part in _PARTS] if self.form == APART else ["alpha"]
        return tuple(Parameter(name, "1/K", _PLAUSIBLE) for name in names)

    def change(self, state: State, values: NDArray) -> Change:
        """Return the derivatives by alpha: coordinates or length times the temperature above the reference."""
        if not state.legs.count:
            return Change(_grown_bodies(state, self.body), len(values))
        fields = grown(state, _PARTS)
        if self.form == COMMON:
            fields = {name: slope.sum(-1, keepdims=True) for name, slope in fields.items()}
        return Change(fields, len(values))


@dataclass(frozen=True)
class LegThermal(SharedOrPerLeg):
    """Legs and the targets on them expand by alpha times the temperature above the reference; base and platform do not.

    All legs share one alpha, or each of ``legs`` has its own.
    """

    id = "leg-thermal"
    lacking = Missing.TEMPERATURE
    step = Step.STRUCTURE
    reads = frozenset({"l", "shape"})
    has_known_scale = True
    parameter = Parameter("alpha", "1/K", _PLAUSIBLE)

    def candidates(self, scene: PointScene) -> Sequence[Self]:
        """Return one candidate for all legs together, every single leg and every pair, if the temperature leaves the
        reference."""
        return super().candidates(scene) if scene.legs and warms(scene) else ()

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the temperature."""
        return (TEMPERATURE,)

    def change(self, state: State, values: NDArray) -> Change:
        """Return the derivatives of legs and their targets by alpha."""
        fields = grown(state, ("legs",))
        if self.legs:
            leg_numbers = np.array(self.legs) - 1
            fields = {"l": self.of_legs(fields["l"][..., 0]), **_targets_on_legs(state, fields, leg_numbers)}
        return Change(fields, len(values))


def _targets_on_legs(state: State, fields: dict[str, NDArray], legs: NDArray) -> dict[str, NDArray]:
    """Return the displacement (B, K, 3, P) of the targets on each of the legs ``legs`` (P,), from 0, by its
    expansion."""
    if state.targets is None or "moved" not in fields:
        return {}
    return {"moved": fields["moved"] * (state.targets.leg[:, None] == legs)[:, None]}


def warms(scene: PointScene) -> bool:
    """True if the temperature is known at all poses and departs from the reference at any."""
    temperature = scene.covariates.get(TEMPERATURE)
    return temperature is not None and bool(
        np.isfinite(temperature).all() and np.any(temperature != scene.reference_temperature_c)
    )


def grown(state: State, parts: Sequence[str]) -> dict[str, NDArray]:
    """Return the derivatives (..., P) of joints, lengths and targets by the expansion of each part."""
    temperature_rise, column = state.temperature_rise, dict(zip(parts, np.eye(len(parts)), strict=True))
    fields = {}
    for name, part in (("a", "base"), ("b", "platform"), ("l", "legs")):
        if part in column and state.legs.count:
            array = getattr(state.legs, name)
            rise = temperature_rise[:, None] if name == "l" else temperature_rise[:, None, None]
            fields[name] = (array * rise)[..., None] * column[part]
    if state.targets is not None and len(state.shape):
        shares = _shares(state.targets, column)
        fields["moved"] = (state.shape * temperature_rise[:, None, None])[..., None] * shares[:, None]
    return fields


def _grown_bodies(state: State, body: str) -> dict[str, NDArray]:
    """Return the derivatives (B, K, 3, 1) of the targets' positions by the expansion of all bodies, or of one."""
    bodies = () if state.targets is None else state.targets.bodies
    is_grown = np.array([not body or other == body for other in bodies], float)
    return {"moved": (state.shape * is_grown[:, None] * state.temperature_rise[:, None, None])[..., None]}


def _shares(targets: Targets, column: dict[str, NDArray]) -> NDArray:
    """Return the mask (K, P) of the part that carries each target; none for a target on an attachment, which is the
    joint."""
    from truing.simulation.targets import BASE, LEG, PLATFORM

    none = np.zeros(len(next(iter(column.values()))))
    of_kind = {BASE: "base", PLATFORM: "platform", LEG: "legs"}
    shares = np.array([column.get(of_kind[int(kind)], none) for kind in targets.body])
    return np.where(targets.at_attachment[:, None], 0.0, shares)
