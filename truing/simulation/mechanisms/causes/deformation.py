"""Causes: deformation of platform and base by the actuators or temperature (telescope report, eq. 1-3), and
flexures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Parameter, ReportedParameter, Step
from truing.simulation.change import Change
from truing.simulation.mechanisms.causes.per_leg import PerLeg, choice_share, choices
from truing.simulation.mechanisms.legs.kinematics import leg_vectors, unit
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.state import State
from truing.simulation.mechanisms.structures.beam_model import circle_distance

# Shift per displacement of a plausible platform: the published one has entries up to 0.02.
_PLAUSIBLE = 0.01
# Plausible nonlinearity: a few micrometres over some millimetres; in 1/m and 1/m^2.
_PLAUSIBLE_TERM = {2: 4.0, 3: 3000.0}
_TERMS = {2: ("quadratic", "1/mm", 1e3), 3: ("cubic", "1/mm^2", 1e6)}
# Least share of a power that a fit of lower powers must leave for the power to be resolved.
_RESOLVED = 0.05
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
class MatrixPlatformDeformation(PointCause):
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
class InPlanePlatformDeformation(PerLeg):
    """Attachment i shifts along x_E and y_E by kappa_x_i delta_rho_i and kappa_y_i delta_rho_i."""

    id = "in-plane-deformation"
    step = Step.STRUCTURE
    share = 0.5  # a plate is far stiffer in its plane than across it
    reads = frozenset({"rho"})

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return kappa_x of each leg concerned, then kappa_y."""
        return tuple(Parameter(n, "1", _PLAUSIBLE) for axis in "xy" for n in self.numbered(f"kappa_{axis}", legs))

    def like_sized(self, legs: int) -> tuple[int, ...]:
        """Return all parameters: those of all legs along both axes are of like size."""
        return tuple(range(len(self.parameters(legs))))

    def change(self, state: State, values: NDArray) -> Change:
        """Return d b_i / d kappa_i = delta_rho_i along x and along y of the platform."""
        spread = self.spread(state.delta_rho)[..., None, :]
        rows = np.concatenate([spread * np.eye(3)[axis][:, None] for axis in (0, 1)], -1)
        return Change({"b": rows}, rows.shape[-1])


@dataclass(frozen=True)
class NonlinearPlatformDeformation(PerLeg):
    """Attachment i shifts along z_E by kappa_i d_i + quadratic_i d_i^2 + cubic_i d_i^3, d_i = delta_rho_i.

    ``powers`` are those above the first: (2,) or (3,) for candidates, or both.
    """

    powers: tuple[int, ...] = (2, 3)

    id = "platform-deformation-nonlinear"
    step = Step.STRUCTURE
    reads = frozenset({"rho"})

    def candidates(self, scene: PointScene) -> Sequence[NonlinearPlatformDeformation]:
        """Return every form for every choice of legs whose displacements resolve its powers."""
        moved = scene.readings - scene.rho0
        informative = {form: _legs_resolving_power(moved, max(form)) for form in _FORMS}
        every = tuple(range(1, scene.legs + 1))
        return [
            NonlinearPlatformDeformation(chosen, form)
            for form, reported in informative.items()
            for chosen in choices(scene.legs)
            if reported.issuperset(chosen or every)
        ]

    def prior(self, scene: PointScene) -> float:
        """Return the share of this form and choice of legs."""
        return _FORMS[self.powers] * choice_share(len(self.legs), scene.legs)

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return kappa of each leg concerned, then their higher-order terms."""
        parameters = [Parameter(name, "1", _PLAUSIBLE) for name in self.numbered("kappa", legs)]
        for power in self.powers:
            name, unit, si = _TERMS[power]
            parameters += [
                Parameter(numbered_name, unit, _PLAUSIBLE_TERM[power], si)
                for numbered_name in self.numbered(name, legs)
            ]
        return tuple(parameters)

    def change(self, state: State, values: NDArray) -> Change:
        """Return d delta_bz_i / d term_i: the power of delta_rho_i."""
        rows = np.concatenate([self.spread(state.delta_rho**power) for power in (1, *self.powers)], -1)
        return Change({"delta_bz": rows}, rows.shape[-1])


def _legs_resolving_power(moved: NDArray, power: int) -> frozenset[int]:
    """Return the legs, from 1, whose displacements (B, L), m, distinguish a power from a sum of lower powers.

    Displacements on only three levels, for example, cannot resolve a cubic term.
    """
    return frozenset(
        leg for leg, column in enumerate(moved.T, start=1) if np.any(column) and _resolves_power(column, power)
    )


def _resolves_power(column: NDArray, power: int) -> bool:
    x = column / np.max(np.abs(column))
    lower = np.linalg.qr(x[:, None] ** np.arange(power))[0]
    remainder = x**power - lower @ (lower.T @ x**power)
    return bool(remainder @ remainder > _RESOLVED**2 * np.sum(x ** (2 * power)))


TEMPERATURE = "temperature"
_COLUMN = "temperature_c"
_READING = "rho"
# Shift at the joints' radius: m per K, and m per m of an actuator's displacement.
_PLAUSIBLE_PER_KELVIN, _PLAUSIBLE_PER_WAY = 5e-6, 0.01
_SHAPES = ("saddle_x", "saddle_y", "bowl")


@dataclass(frozen=True)
class BaseDeformation(PointCause):
    """Base targets and joints shift along z by q (saddle_x (x^2 - y^2) + saddle_y 2 x y + bowl (x^2 + y^2)) / R^2.

    R is the mean radius of the joints; q is the temperature above the reference, or the displacement of the actuator
    ``driver`` (``rho1`` ..).
    """

    driver: str = TEMPERATURE

    id = "base-deformation"
    step = Step.STRUCTURE
    reads = frozenset({"rho", "a", "shape"})

    def candidates(self, scene: PointScene) -> Sequence[BaseDeformation]:
        """Return one candidate for the temperature, if it varies, and one for every actuator that moves."""
        moves = np.ptp(scene.readings, axis=0) > 0
        drivers = [f"{_READING}{leg}" for leg in range(1, scene.legs + 1) if moves[leg - 1]]
        warm = scene.varies(_COLUMN) and bool(np.isfinite(scene.covariates[_COLUMN]).all())
        return [BaseDeformation(driver) for driver in ([TEMPERATURE] if warm else []) + drivers]

    def prior(self, scene: PointScene) -> float:
        """Return the share of this driver: temperature is as probable as all actuators together."""
        return 0.5 if self.driver == TEMPERATURE else 0.5 / scene.legs

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return the temperature column, if the temperature is the driver."""
        return (_COLUMN,) if self.driver == TEMPERATURE else ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return saddle_x, saddle_y and bowl: the shift at the radius R per unit of the driver."""
        warm = self.driver == TEMPERATURE
        unit, scale, si = ("mm/K", _PLAUSIBLE_PER_KELVIN, 1e-3) if warm else ("mm/mm", _PLAUSIBLE_PER_WAY, 1.0)
        return tuple(Parameter(name, unit, scale, si) for name in _SHAPES)

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the driver, then the sizes of the three shapes."""
        return (ReportedParameter("driver", self.driver, None, ""), *super().reported(values, covariance, legs))

    def change(self, state: State, values: NDArray) -> Change:
        """Return the shift of joints and base targets along z per size of each shape."""
        across = state.legs.a[..., :2]
        radius = np.mean(np.sqrt(np.sum(across * across, -1)), -1)[..., None]
        q = self._driver_values(state)[:, None, None]
        fields = {"a": _along_z(q * _shapes(across / radius[..., None]))}
        if state.targets is not None and len(state.shape):
            on_base = (state.targets.body == 0)[:, None]
            positions = state.shape[:, :2] / radius[..., None]
            fields["moved"] = _along_z(q * _shapes(positions) * on_base)
        return Change(fields, len(_SHAPES))

    def _driver_values(self, state: State) -> NDArray:
        if self.driver == TEMPERATURE:
            return state.temperature_rise
        return state.delta_rho[:, int(self.driver.removeprefix(_READING)) - 1]


def _shapes(position: NDArray) -> NDArray:
    """Return saddle_x, saddle_y and bowl (..., 3) at positions (..., 2) in units of the joints' radius."""
    x, y = position[..., 0], position[..., 1]
    return np.stack([x * x - y * y, 2 * x * y, x * x + y * y], -1)


def _along_z(heights: NDArray) -> NDArray:
    """Return heights (..., P) as vectors along z (..., 3, P)."""
    return heights[..., None, :] * np.array([0.0, 0.0, 1.0])[:, None]


_PLAUSIBLE_M = 0.01


@dataclass(frozen=True)
class FlexureShift(PointCause):
    """Legs end in flexures of equal length, whose ends move on a circle as they bend (telescope report, eq. 13-17).

    Flexures are straight at the reference pose, where the machine was assembled. Bending changes the distance between
    the joints' ideal pivots.
    """

    id = "flexure-shift"
    step = Step.STRUCTURE
    reads = frozenset({"pose", "rho", "a", "b", "u", "delta_bz", "reference_direction", "reference_rotation"})

    def candidates(self, scene: PointScene) -> Sequence[FlexureShift]:
        """Return the cause if the machine has legs."""
        return (self,) if scene.legs else ()

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the length of a flexure."""
        return (Parameter("flexure_length", "mm", _PLAUSIBLE_M, 1e-3),)

    def change(self, state: State, values: NDArray) -> Change:
        """Return d l / d flexure_length: elongation of each leg between its pivots, from the bending at both ends."""
        z = unit(leg_vectors(state.legs, state.p, state.R, state.rho, state.delta_bz))
        seen = np.einsum("...ij,...kj,...lk->...li", state.R, state.reference_rotation, state.reference_direction)
        low, high = np.sum(z * state.reference_direction, -1), np.sum(z * seen, -1)
        ones = np.ones_like(low)
        shift = circle_distance(ones, low).value + circle_distance(ones, high).value - 1.0
        return Change({"l": shift[..., None]}, 1)
