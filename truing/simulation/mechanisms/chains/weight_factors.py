"""Payload or masses of links declared in another unit: deflections follow another ratio of the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array
from truing.simulation.cause import Parameter, ReportedParameter
from truing.simulation.inputs import Missing
from truing.simulation.mechanisms.chains.causes import (
    DECLARED_WEIGHTS,
    ChainScene,
    JointCause,
    JointCompliance,
)
from truing.simulation.mechanisms.chains.conditions import ChainInputs
from truing.simulation.mechanisms.chains.mass_centres import carries_off_centre

PAYLOAD, LINKS = "payload", "links"
# Numbers in g, lb or N in place of kg, times these, are right.
MASS_UNITS = {"g": 1e-3, "lb": 0.45359237, "N": 1.0 / 9.80665}
_MM = 1e-3
_DEFLECTED, _DEFLECTED_M = 5e-4, 3e-4  # plausible deflections under the largest load, rad and m
_WIDTH = 0.1  # plausible deviation of a factor, as a share of it
_INDEPENDENT = 0.02  # least share of a load that is independent of the other one and of a constant
_NEGLIGIBLE = 1e-6  # N m, N
# A unit is named if it lies within the 99 % interval of the factor, and one beyond five standard deviations. Declared
# masses are uncertain by two per cent at least.
_WITHIN, _BEYOND, _EXACT = 2.6, 5.0, 0.02


@dataclass(frozen=True)
class WeightFactor(JointCause):
    """A joint deflects under weight as if the payload, or all masses of links, were the declared ones times a factor.

    Only the ratio of payload and masses shows: a factor of both is one of the compliance. ``part``: whose weight the
    factor multiplies. ``load``: largest torque then, N m, or force, N. If ``free``, a relative deviation from the
    factor is a parameter next to the compliance.
    """

    part: str = PAYLOAD
    factor: float = 1.0
    load: float = 1.0
    free: bool = False

    id = "weight-factor"
    plain_id = JointCompliance.id
    denies = DECLARED_WEIGHTS

    @property
    def family(self) -> str:
        """Compliance of one joint: a model holds one form of it."""
        return f"{JointCompliance.id} {self.joint}"

    def missing_input(self, scene: ChainScene) -> Missing | None:
        """Return the weights where a joint's compliance lacks them too; without a payload there is no ratio."""
        return Missing.WEIGHT if scene.inputs_of_machine.gravity is None else None

    def candidates(self, scene: ChainScene) -> Sequence[WeightFactor]:
        """Return each unit of either part, for every joint on which both loads vary apart; none with a mass whose
        centre is unknown, which changes the ratio as well."""
        machine = scene.inputs_of_machine
        if machine.gravity is None or not machine.conditions.payload_kg.any():
            return ()
        of_links = machine.without_payload
        result: list[WeightFactor] = []
        for joint in super().candidates(scene):
            reading = machine.tree.readings.index(joint.joint)
            has_unknown_centre = joint.is_angle and carries_off_centre(machine, machine.tree.node_of(reading))
            if has_unknown_centre or not _are_apart(machine, of_links, reading):
                continue
            for part in (PAYLOAD, LINKS):
                for factor in MASS_UNITS.values():
                    form = replace(joint, part=part, factor=factor)
                    right, wrong = form._loads(machine)
                    result.append(replace(form, load=float(np.abs(right + wrong).max())))
        return result

    def _loads(self, machine: ChainInputs) -> tuple[Array, Array]:
        """Return the load (B,) on the joint by the part that is right, and by the other times its factor."""
        reading = machine.tree.readings.index(self.joint)
        links = machine.without_payload.torque(reading)
        payload = machine.torque(reading) - links
        right, wrong = (links, payload) if self.part == PAYLOAD else (payload, links)
        return right, self.factor * wrong

    def one_sided(self, legs: int) -> tuple[int, ...]:
        """Return the compliance: it cannot be negative."""
        return (0,)

    def refined(self) -> WeightFactor:
        """Return the form in which the factor is fitted, so that its uncertainty shows which units are possible."""
        return replace(self, free=True)

    def is_distinct(self, values: NDArray, covariance: NDArray) -> bool:
        """True if the factor is clearly not one, and that of one unit alone."""
        value, sigma = self._fitted_factor(values, covariance) if self.free else (self.factor, 0.0)
        return not self.free or (len(self._units(value, sigma)) == 1 and abs(value - 1.0) > _BEYOND * sigma)

    def _fitted_factor(self, values: NDArray, covariance: NDArray) -> tuple[float, float]:
        value = float(self.factor * (1.0 + values[-1]))
        return value, max(float(self.factor * np.sqrt(covariance[-1, -1])), _EXACT * abs(value))

    def _units(self, value: float, sigma: float) -> list[str]:
        return [unit for unit, factor in MASS_UNITS.items() if abs(value - factor) < _WITHIN * sigma]

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return the compliance; then the relative deviation from the factor, if it is free."""
        compliance = (
            Parameter("compliance", "rad/(N m)", _DEFLECTED / self.load)
            if self.is_angle
            else Parameter("compliance", "mm/N", _DEFLECTED_M / self.load, _MM)
        )
        return (compliance, Parameter("factor", "1", _WIDTH)) if self.free else (compliance,)

    def reported(self, values: NDArray, covariance: NDArray, legs: int) -> tuple[ReportedParameter, ...]:
        """Return the compliance, the factor itself, and the units that its interval holds."""
        compliance, *_ = super().reported(values, covariance, legs)
        value, sigma = self._fitted_factor(values, covariance) if self.free else (self.factor, 0.0)
        units = self._units(value, max(sigma, _EXACT * value))
        factor = ReportedParameter("factor", value, sigma or None, "1")
        return compliance, factor, ReportedParameter("units", " ".join(units), None, "")

    def motion(self, machine: ChainInputs, reading: int) -> NDArray:
        """Return the load on the joint; zero by the deviation from the factor, which acts only on a compliant joint."""
        right, wrong = self._loads(machine)
        return np.column_stack([right + wrong, np.zeros((len(right), int(self.free)))])

    def deviation_slopes(self, machine: ChainInputs, values: NDArray) -> NDArray:
        """Return the derivatives of the deviations by the compliance and the deviation from the factor."""
        right, wrong = self._loads(machine)
        slopes = [right + wrong]
        if self.free:
            slopes = [right + (1.0 + values[1]) * wrong, values[0] * wrong]
        return machine.of_joint(machine.tree.readings.index(self.joint), np.column_stack(slopes))

    def deviation(self, machine: ChainInputs, values: NDArray) -> NDArray:
        """Return the deviations at a compliance and, if it is free, a deviation from the factor."""
        return np.asarray(values[0] * self.deviation_slopes(machine, values)[..., 0])


def _are_apart(machine: ChainInputs, of_links: ChainInputs, reading: int) -> bool:
    """Return True where payload and links load a joint by functions of the pose that differ by more than a factor."""
    links = of_links.torque(reading)
    payload = machine.torque(reading) - links
    design = np.column_stack([np.ones(len(links)), links])
    size = float(np.std(payload))
    if min(size, float(np.std(links))) < _NEGLIGIBLE:
        return False
    left = payload - design @ np.linalg.lstsq(design, payload, rcond=None)[0]
    return float(np.std(left)) > _INDEPENDENT * size
