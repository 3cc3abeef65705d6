"""Nonparametric effects on rays: a parameter of a camera or a scale bar depends smoothly on inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from truing.simulation.inputs import ORDER, TEMPERATURE, TIME, middle_and_half, varying_columns
from truing.simulation.nonparametric import PER_FUNCTION, POLYNOMIAL, WAVES, NonparametricEffect, dependence
from truing.simulation.photographs.causes.ray_causes import RayCause, RayScene, at_numbers
from truing.simulation.photographs.ray_poses import BAR, CAMERA, RayPoses

# Parameters of a camera or bar that may depend on inputs, and their plausible amplitudes: half of the full range.
_PLAUSIBLE = {"c": 0.5, "x0": 0.5, "y0": 0.5, "strain": 5e-5}
_POLYNOMIALS, _WAVES = (1, 2, 3), (2, 4)
_MOST_DRIVES = 8


@dataclass(frozen=True)
class NonparametricRayEffect(NonparametricEffect[RayScene], RayCause):
    """A parameter of a camera or a scale bar depends on inputs: columns of the poses, or the product of two."""

    owner_kind: str = CAMERA
    owner: str = ""
    name: str = "c"
    unit: str = "px"

    reach = 100.0

    @property
    def subject(self) -> str:
        """Camera or scale bar concerned."""
        return f"{self.owner_kind} {self.owner}"

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: a camera does not move the machine."""
        return ()

    def candidates(self, scene: RayScene) -> Sequence[NonparametricRayEffect]:
        """Return all dependences of each parameter for which there are enough poses."""
        rays = scene.rays
        columns = varying_columns(rays.covariates)
        ranges = {column: middle_and_half(values) for column, values in columns.items()}
        effects: list[NonparametricRayEffect] = []
        for index, number in enumerate(rays.parameters):
            if number.name not in _PLAUSIBLE or number.kind not in (CAMERA, BAR) or not rays.determinable[index]:
                continue
            count = int(rays.poses_of(number.kind, number.owner).sum())
            owner = {"owner_kind": number.kind, "owner": number.owner, "name": number.name, "unit": number.unit}
            effects += [
                NonparametricRayEffect(**(dependence(inputs, ranges.__getitem__, form, degree) | owner))
                for inputs, form, degree in _dependences(list(columns))
                if count >= PER_FUNCTION * degree and not _is_catalogued(number.kind, inputs, degree)
            ]
        return effects

    def slopes(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return the values of the functions at every pose."""
        indices = rays.places(self.owner_kind, self.owner, (self.name,))
        basis = self.basis(rays.covariates.__getitem__)
        return np.concatenate([at_numbers(rays, indices, column) for column in basis.T], -1)

    @property
    def _in_key(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return (self.subject, self.name), ()

    @property
    def _amplitude(self) -> tuple[str, float, float]:
        return self.unit, 1.0, _PLAUSIBLE[self.name]


def _dependences(columns: list[str]) -> list[tuple[tuple[str, ...], str, int]]:
    """Return inputs, form and degree of all dependences."""
    dependences = [((column,), POLYNOMIAL, degree) for column in columns for degree in _POLYNOMIALS]
    dependences += [((column,), WAVES, count) for column in columns if column in (TIME, ORDER) for count in _WAVES]
    drives = [column for column in columns if column not in (TIME, ORDER, TEMPERATURE)]
    pairs = combinations(drives, 2) if len(drives) <= _MOST_DRIVES else ()
    return dependences + [(pair, POLYNOMIAL, 1) for pair in pairs]


def _is_catalogued(kind: str, columns: tuple[str, ...], degree: int) -> bool:
    """True if a linear course is that of a catalogued cause: of cameras in time and temperature, of bars in
    temperature."""
    named = {TIME, TEMPERATURE} if kind == CAMERA else {TEMPERATURE}
    return degree == 1 and len(columns) == 1 and columns[0] in named
