"""The platform deforms: its attachments shift along its own z as the actuators move (telescope report, eq. 1-3)."""

from __future__ import annotations

import numpy as np

from truing.simulation.chain import Cause, Parameter, State, Step
from truing.simulation.legs import Change

# Shift per displacement of a plausible platform: the published one has entries up to 0.02.
_PLAUSIBLE = 0.01


class LinearPlatformDeformation(Cause):
    """Attachment i shifts along z_E by kappa_i delta_rho_i (eq. 1)."""

    id = "platform-deformation-linear"
    step = Step.STRUCTURE
    says = "each attachment shifts along the platform's z in proportion to its own actuator's displacement"
    confirm = "Move one actuator at a time through its range and measure the targets at all attachments."

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return kappa_1 .. kappa_L."""
        return tuple(Parameter(f"kappa_{leg}", "1", _PLAUSIBLE) for leg in range(1, legs + 1))

    def change(self, state: State) -> Change:
        """Return d delta_bz_i / d kappa_j = delta_rho_i where i is j."""
        legs = state.legs.count
        return Change({"delta_bz": state.delta_rho[..., None] * np.eye(legs)}, legs)


class MatrixPlatformDeformation(Cause):
    """Attachments shift along z_E by K delta_rho (eq. 2, 3)."""

    id = "platform-deformation-matrix"
    step = Step.STRUCTURE
    says = "the attachments shift along the platform's z in proportion to all actuators' displacements"
    confirm = "Move one actuator at a time through its range and measure the targets at all attachments."

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return K11, K12, .. KLL, row by row; with ten legs or more as K1_1."""
        between = "_" if legs > 9 else ""
        pairs = ((i, j) for i in range(1, legs + 1) for j in range(1, legs + 1))
        return tuple(Parameter(f"K{i}{between}{j}", "1", _PLAUSIBLE) for i, j in pairs)

    def change(self, state: State) -> Change:
        """Return d delta_bz_i / d K_ij = delta_rho_j, parameters row by row."""
        legs = state.legs.count
        rows = np.eye(legs)[:, :, None] * state.delta_rho[..., None, None, :]
        return Change({"delta_bz": rows.reshape(*rows.shape[:-2], legs * legs)}, legs * legs)
