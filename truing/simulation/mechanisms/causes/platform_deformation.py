"""The platform deforms: its attachments shift along its own z as the actuators move (telescope report, eq. 1-3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Parameter, Scene, Step
from truing.simulation.change import Change
from truing.simulation.mechanisms.causes.per_leg import PerLeg, choice_share, choices
from truing.simulation.mechanisms.state import State

# Shift per displacement of a plausible platform: the published one has entries up to 0.02.
_PLAUSIBLE = 0.01
# What bends in proportion over some millimetres departs from that by a few micrometres: 1/m and 1/m^2.
_PLAUSIBLE_TERM = {2: 4.0, 3: 3000.0}
_TERMS = {2: ("quadratic", "1/mm", 1e3), 3: ("cubic", "1/mm^2", 1e6)}
# The least share of a power's size that lower ones may leave of it.
_TOLD = 0.05
_FORMS: dict[tuple[int, ...], float] = {(2,): 0.5, (3,): 0.5}


@dataclass(frozen=True)
class LinearPlatformDeformation(PerLeg):
    """Attachment i shifts along z_E by kappa_i delta_rho_i (eq. 1)."""

    id = "platform-deformation-linear"
    step = Step.STRUCTURE
    reads = frozenset({"rho"})

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return kappa of each leg concerned."""
        return tuple(Parameter(name, "1", _PLAUSIBLE) for name in self.numbered("kappa", legs))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d delta_bz_i / d kappa_i = delta_rho_i."""
        rows = self.spread(state.delta_rho)
        return Change({"delta_bz": rows}, rows.shape[-1])


@dataclass(frozen=True)
class MatrixPlatformDeformation(Cause):
    """Attachments shift along z_E by K delta_rho (eq. 2, 3)."""

    id = "platform-deformation-matrix"
    step = Step.STRUCTURE
    reads = frozenset({"rho"})

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return K11, K12, .. KLL, row by row; with ten legs or more as K1_1."""
        between = "_" if legs > 9 else ""
        pairs = ((i, j) for i in range(1, legs + 1) for j in range(1, legs + 1))
        return tuple(Parameter(f"K{i}{between}{j}", "1", _PLAUSIBLE) for i, j in pairs)

    def change(self, state: State, values: NDArray) -> Change:
        """Return d delta_bz_i / d K_ij = delta_rho_j, parameters row by row."""
        legs = state.legs.count
        rows = np.eye(legs)[:, :, None] * state.delta_rho[..., None, None, :]
        return Change({"delta_bz": rows.reshape(*rows.shape[:-2], legs * legs)}, legs * legs)


@dataclass(frozen=True)
class NonlinearPlatformDeformation(PerLeg):
    """Attachment i shifts along z_E by kappa_i d_i + quadratic_i d_i^2 + cubic_i d_i^3, d_i = delta_rho_i.

    ``powers`` are those beyond the first: (2,) or (3,) where it is searched for, or both.
    """

    powers: tuple[int, ...] = (2, 3)

    id = "platform-deformation-nonlinear"
    step = Step.STRUCTURE
    reads = frozenset({"rho"})

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return every form for every choice of legs whose displacements tell the terms apart."""
        moved = scene.readings - scene.rho0
        telling = {form: _telling(moved, max(form)) for form in _FORMS}
        every = tuple(range(1, scene.legs + 1))
        return [
            NonlinearPlatformDeformation(chosen, form)
            for form, told in telling.items()
            for chosen in choices(scene.legs)
            if told.issuperset(chosen or every)
        ]

    def prior(self, scene: Scene) -> float:
        """Return the share of this form and choice of legs."""
        return _FORMS[self.powers] * choice_share(len(self.legs), scene.legs)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return kappa of each leg concerned, then their further terms."""
        found = [Parameter(name, "1", _PLAUSIBLE) for name in self.numbered("kappa", legs)]
        for power in self.powers:
            name, unit, si = _TERMS[power]
            found += [Parameter(each, unit, _PLAUSIBLE_TERM[power], si) for each in self.numbered(name, legs)]
        return tuple(found)

    def change(self, state: State, values: NDArray) -> Change:
        """Return d delta_bz_i / d term_i = the power of delta_rho_i that it multiplies."""
        rows = np.concatenate([self.spread(state.delta_rho**power) for power in (1, *self.powers)], -1)
        return Change({"delta_bz": rows}, rows.shape[-1])


def _telling(moved: NDArray, power: int) -> frozenset[int]:
    """Return the legs, from 1, whose displacements (B, L), m, tell a power from lower ones: by what these leave of it.

    Displacements on three levels, as many as a cubic term would need beside them, show a straight line for it.
    """
    return frozenset(leg for leg, column in enumerate(moved.T, start=1) if np.any(column) and _tells(column, power))


def _tells(column: NDArray, power: int) -> bool:
    x = column / np.max(np.abs(column))
    lower = np.linalg.qr(x[:, None] ** np.arange(power))[0]
    rest = x**power - lower @ (lower.T @ x**power)
    return bool(rest @ rest > _TOLD**2 * np.sum(x ** (2 * power)))
