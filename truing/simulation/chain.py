"""The simulated chain drive -> structure -> instrument, and how a change anywhere travels down it.

A state holds what the three steps pass on. An effect (a cause with values for its parameters) changes the state
at its own step; what follows downstream follows from the chain, in value and in exact derivative.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from truing.simulation.kinematics import forward
from truing.simulation.legs import Change, Legs


class Step(StrEnum):
    """Where in the chain a cause acts."""

    DRIVE = "drive"
    STRUCTURE = "structure"
    INSTRUMENT = "instrument"


@dataclass(frozen=True)
class Parameter:
    """A parameter of a cause: its name and unit as in the tables, how large it plausibly is (one sigma), in SI.

    ``si`` is what one unit of the tables is in SI.
    """

    name: str
    unit: str
    scale: float
    si: float = 1.0


class Cause:
    """A way in which nature departs from the plain simulation; a subclass is all that a new cause takes.

    ``change`` returns the derivative of the state by the cause's parameters. For a linear cause it is its whole
    effect; `Effect` multiplies it by the parameters' values.
    """

    id: str
    kind: str = "linear"
    step: Step

    @property
    def says(self) -> str:
        """Return what nature does, in words that fit "The data show that ..."."""
        raise NotImplementedError

    @property
    def confirm(self) -> str:
        """Return what to measure to confirm it."""
        raise NotImplementedError

    @property
    def key(self) -> str:
        """Return the name that tells it from all others; its id unless there are several of the kind."""
        return self.id

    def follows(self, legs: int) -> tuple[str, ...]:
        """Return the columns that it follows where it is no cause of the catalogue; else none."""
        return ()

    def settings(self) -> dict[str, str | float | int]:
        """Return what a model needs beside the parameters to know the cause again."""
        return {}

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the parameters for a mechanism with that many legs."""
        raise NotImplementedError

    def change(self, state: State) -> Change:
        """Return the derivative of the state's fields by the parameters; complex-safe."""
        raise NotImplementedError


@dataclass(frozen=True)
class Effect:
    """A cause with the values of its parameters, in their units' SI form."""

    cause: Cause
    values: NDArray  # (P,)

    def apply(self, state: State) -> State:
        """Return the state as this effect leaves it."""
        change = self.cause.change(state)
        return state.shifted({name: slope @ self.values for name, slope in change.fields.items()})


@dataclass(frozen=True)
class State:
    """What the chain passes on, B poses of L legs; m and rad.

    ``indicated`` is where the actuators seem to stand (what effects of the drive depend on), ``rho`` where they do,
    ``delta_bz`` the attachments' shift along z of the platform; the pose p, R of the platform in the base frame is set
    once the structure has answered.
    """

    legs: Legs
    rho: NDArray  # (B, L)
    delta_bz: NDArray  # (B, L)
    p: NDArray = field(default_factory=lambda: np.empty((0, 3)))  # (B, 3)
    R: NDArray = field(default_factory=lambda: np.empty((0, 3, 3)))  # (B, 3, 3)
    converged: NDArray = field(default_factory=lambda: np.empty(0, bool))  # (B,)
    indicated: NDArray = field(default_factory=lambda: np.empty((0, 0)))  # (B, L)
    covariates: Mapping[str, NDArray] = field(default_factory=dict)  # (B,) or (B, L), in the units of their columns

    @property
    def delta_rho(self) -> NDArray:
        """Return the displacement (B, L) from the reference reading, m."""
        return self.rho - self.legs.rho0

    def shifted(self, shifts: dict[str, NDArray]) -> State:
        """Return the state with each named field moved by the array given for it."""
        own = {name: getattr(self, name) + shift for name, shift in shifts.items() if name in ("rho", "delta_bz")}
        joints = {name: getattr(self.legs, name) + shift for name, shift in shifts.items() if name not in own}
        return replace(self, **own, legs=self.legs.replace(**joints) if joints else self.legs)


def simulate(
    legs: Legs, rho: NDArray, effects: Sequence[Effect] = (), covariates: Mapping[str, NDArray] | None = None
) -> State:
    """Return the state at indicated positions rho (B, L), m, with the effects in force and the platform's poses."""
    state = State(legs, rho, np.zeros_like(rho), indicated=rho, covariates=covariates or {})
    for step in (Step.DRIVE, Step.STRUCTURE):
        for effect in effects:
            if effect.cause.step is step:
                state = effect.apply(state)
    reached = forward(state.legs, state.rho, state.delta_bz)
    return replace(state, p=reached.p, R=reached.R, converged=reached.converged)


def carried(state: State, effects: Sequence[Effect], change: Change) -> Change:
    """Return a change with all that follows from it down the chain, in effects that depend on what it changes."""
    fields = dict(change.fields)
    indicated = fields.pop("indicated", None)
    if indicated is not None:
        fields["rho"] = fields.get("rho", 0.0) + indicated
        _follow(
            fields, state, [effect for effect in effects if effect.cause.step is Step.DRIVE], "indicated", indicated
        )
    if "rho" in fields:
        _follow(
            fields, state, [effect for effect in effects if effect.cause.step is Step.STRUCTURE], "rho", fields["rho"]
        )
    return Change(fields, change.size)


def _follow(fields: dict[str, NDArray], state: State, effects: Sequence[Effect], source: str, driven: NDArray) -> None:
    """Add to the fields what effects make of a change ``driven`` (B, L, P) of their source."""
    for effect in effects:
        for name, slope in _slope(effect, state, source).items():
            fields[name] = fields.get(name, 0.0) + np.einsum("b...m,bmp->b...p", slope, driven)


def _slope(effect: Effect, state: State, source: str) -> dict[str, NDArray]:
    """Return the derivative of an effect by its source at each leg, leg last: a complex step, exact to rounding."""
    tiny = 1e-30
    columns: dict[str, list[NDArray]] = {}
    for leg in range(state.legs.count):
        nudge = 1j * tiny * (np.arange(state.legs.count) == leg)
        nudged = replace(state, **{source: getattr(state, source) + nudge})
        for name, slope in effect.cause.change(nudged).fields.items():
            columns.setdefault(name, []).append((slope @ effect.values).imag / tiny)
    return {name: np.stack(found, -1) for name, found in columns.items()}
