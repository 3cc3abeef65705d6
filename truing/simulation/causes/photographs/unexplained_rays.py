"""What no cause of the catalogue explains of rays: a number of a camera or bar follows columns, in no declared form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Parameter, Scene
from truing.simulation.causes.following import POLYNOMIAL, WAVES, chebyshev, waves
from truing.simulation.causes.photographs.of_rays import RayCause, at_numbers, rays_of
from truing.simulation.causes.undeclared import FURTHER, IN_PROPORTION, Undeclared
from truing.simulation.photographs.ray_poses import BAR, CAMERA, ORDER, TEMPERATURE, TIME, RayPoses

# What of a camera or a bar may follow something, each by itself, and how much of it is plausible: an amplitude is half
# of what there is from one end to the other.
_PLAUSIBLE = {"c": 0.5, "x0": 0.5, "y0": 0.5, "strain": 5e-5}
_POLYNOMIALS, _WAVES = (1, 2, 3), (2, 4)
_PER_FUNCTION = 4  # poses
_MOST_DRIVES = 8


@dataclass(frozen=True)
class UnexplainedRays(Undeclared, RayCause):
    """A number of a camera or a bar follows columns (several: their product), brought to -1 .. 1 by centre and half
    range: Chebyshev polynomials of degree ``first`` .. ``degree``, or so many slow waves (cosines)."""

    owner_kind: str = CAMERA
    owner: str = ""
    name: str = "c"
    unit: str = "px"
    columns: tuple[str, ...] = (TIME,)
    centres: tuple[float, ...] = (0.0,)
    half_ranges: tuple[float, ...] = (1.0,)
    form: str = POLYNOMIAL
    degree: int = 1
    first: int = 1

    id = "unexplained"
    catalogued = False
    reach = 100.0

    @property
    def subject(self) -> str:
        """Return the camera or the bar."""
        return f"{self.owner_kind} {self.owner}"

    @property
    def key(self) -> str:
        """Return the name that tells it from others of its kind."""
        return f"{self.id} {self.subject} {self.name} {' '.join(self.columns)} {self.form} {self.terms}"

    def follows(self, legs: int) -> tuple[str, ...]:
        """Return the columns that it follows."""
        return tuple(dict.fromkeys(TIME if column == ORDER else column for column in self.columns))

    def needs(self, legs: int) -> tuple[str, ...]:
        """Return no column: what a camera does moves no machine."""
        return ()

    def covers(self, covariates: Mapping[str, NDArray], poses: int) -> NDArray:
        """Return the poses (B,) within the range of what it follows, beyond which its form says nothing."""
        return self.within(covariates, poses)

    def candidates(self, scene: Scene) -> Sequence[Cause]:
        """Return everything that each number may follow, as far as its poses allow."""
        rays = rays_of(scene)
        found: list[Cause] = []
        for place, number in enumerate(rays.parameters):
            if number.name not in _PLAUSIBLE or number.kind not in (CAMERA, BAR) or not rays.tells[place]:
                continue
            count = int(rays.poses_of(number.kind, number.owner).sum())
            bare = UnexplainedRays(number.kind, number.owner, number.name, number.unit)
            for columns, form, degree in _followings(rays):
                if count >= _PER_FUNCTION * degree and not _has_a_name(number.kind, columns, degree):
                    ranges = [_range(rays, column) for column in columns]
                    centres, halves = tuple(c for c, _ in ranges), tuple(h for _, h in ranges)
                    found.append(
                        replace(bare, columns=columns, centres=centres, half_ranges=halves, form=form, degree=degree)
                    )
        return found

    def further(self, scene: Scene) -> Sequence[Cause]:
        """Return its next terms."""
        return [replace(self, first=self.degree + 1, degree=self.degree + more) for more in range(1, FURTHER + 1)]

    def prior(self, scene: Scene) -> float:
        """Return the weight: what is in proportion to one column is likelier than other forms."""
        return IN_PROPORTION if self.form == POLYNOMIAL and self.in_proportion else 1.0

    def parameters(self, legs: int) -> tuple[Parameter, ...]:
        """Return one amplitude per function."""
        letter = "wave" if self.form == WAVES else "degree"
        scale = _PLAUSIBLE[self.name]
        return tuple(Parameter(f"{letter}{k}", self.unit, scale) for k in range(self.first, self.degree + 1))

    def slopes(self, rays: RayPoses, values: NDArray) -> NDArray:
        """Return the functions' values at every pose."""
        x = np.ones(len(rays.poses))
        for column, centre, half in zip(self.columns, self.centres, self.half_ranges, strict=True):
            x = x * ((rays.covariates[column] - centre) / half)
        basis = (waves if self.form == WAVES else chebyshev)(x, self.degree)[:, self.first - 1 :]
        place = rays.places(self.owner_kind, self.owner, (self.name,))
        return np.concatenate([at_numbers(rays, place, column) for column in basis.T], -1)


def _followings(rays: RayPoses) -> list[tuple[tuple[str, ...], str, int]]:
    """Return columns, form and degree of what the numbers of a campaign may follow."""
    single = [column for column, values in rays.covariates.items() if np.ndim(values) == 1 and rays.varies(column)]
    timed = [column for column in single if column != ORDER or TIME not in single]
    found = [((column,), POLYNOMIAL, degree) for column in timed for degree in _POLYNOMIALS]
    found += [((column,), WAVES, count) for column in timed if column in (TIME, ORDER) for count in _WAVES]
    drives = [column for column in timed if column not in (TIME, ORDER, TEMPERATURE)]
    pairs = [(a, b) for n, a in enumerate(drives) for b in drives[n + 1 :]] if len(drives) <= _MOST_DRIVES else []
    return found + [(pair, POLYNOMIAL, 1) for pair in pairs]


def _has_a_name(kind: str, columns: tuple[str, ...], degree: int) -> bool:
    """Return whether a straight course is a cause's: of cameras in time and temperature, of bars in the latter."""
    named = {TIME, TEMPERATURE} if kind == CAMERA else {TEMPERATURE}
    return degree == 1 and len(columns) == 1 and columns[0] in named


def _range(rays: RayPoses, column: str) -> tuple[float, float]:
    values = rays.covariates[column]
    low, high = float(np.min(values)), float(np.max(values))
    return (low + high) / 2.0, (high - low) / 2.0
