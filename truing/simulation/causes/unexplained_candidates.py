"""What may follow what in a campaign, where no cause of the catalogue says so: a few hundred candidates.

What a cause of the catalogue already does in the very same form (readings in proportion to the own drive: a gain) is
not told again here: data could not tell the two apart, and the name would be lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import Cause, Profiles, Scene
from truing.simulation.causes.following import (
    ALL_DRIVES,
    LAST_STEP,
    LOOKING_BACK,
    MEMORY,
    ORDER,
    OWN_DRIVE,
    POLYNOMIAL,
    TIME,
    WAVES,
    waves,
)
from truing.simulation.causes.per_leg import choices

if TYPE_CHECKING:
    from collections.abc import Mapping

TEMPERATURE = "temperature_c"
_SMOOTH = 3  # degree of the polynomials that stand for any smooth dependence
_WAVES = 6  # half periods of slow waves over a campaign
# A smooth dependence without a form wants this many poses per function.
POSES_PER_FUNCTION = 4
_FEWEST_SEEN = 6
_FEWEST_PATTERNED = 4
PATTERNS = ("slope1", "slope2", "bend1", "twist", "bend2")

Follow = dict[str, Any]


def followings(scene: Scene) -> Iterator[Follow]:
    """Return the settings of everything that legs, bodies and the scale may follow."""
    shapes = _Shapes(scene)
    for legs in choices(scene.legs, 1) if scene.legs else []:
        for quantity, follows in (
            ("readings", _readings(shapes, legs)),
            ("lengths", _lengths(shapes)),
            ("attachments", _attachments(shapes, legs)),
            ("attachments sideways", _sideways(shapes)),
        ):
            yield from ({"quantity": quantity, "legs": legs, **follow} for follow in follows)
    for legs in [chosen for chosen in choices(scene.legs, 2) if len(chosen) == 2]:
        yield from ({"quantity": "readings", "legs": legs, **follow} for follow in shapes.columns(1))
        if scene.lengths_apart:
            apart = shapes.columns(1, apart_from=(TIME, TEMPERATURE))
            yield from ({"quantity": "lengths", "legs": legs, **follow} for follow in apart)
    yield from ({"quantity": "scale", **follow} for follow in _scale(shapes))
    for body in _patterned(scene) if scene.legs else ():
        single = [*shapes.columns(1), *shapes.drives(1)]
        yield from ({"quantity": "targets", **body, **follow} for follow in single)


def patterns(places: NDArray) -> NDArray:
    """Return smooth patterns (T, 5) over a body at places (T, 2): its two slopes, its two curvatures, and a twist."""
    s, t = places.T
    return np.stack([s, t, s * s, s * t, t * t], -1)


def _readings(shapes: _Shapes, legs: tuple[int, ...]) -> Iterator[Follow]:
    yield from shapes.columns(1)
    yield from shapes.columns(_SMOOTH)
    yield from shapes.waves()
    yield from (shapes.own(2), shapes.own(_SMOOTH))
    yield from shapes.own_with_columns()
    yield from shapes.look_back()
    yield from shapes.drives(1, apart_from=legs)
    yield from shapes.drives(2, apart_from=legs)
    yield from shapes.products()
    if not legs:
        yield shapes.all_drives()


def _lengths(shapes: _Shapes) -> Iterator[Follow]:
    """A leg's length; where the leg itself is the actuator there is nothing new in it."""
    if not shapes.lengths_apart:
        return
    yield from shapes.columns(1, apart_from=(TIME, TEMPERATURE))
    yield from shapes.columns(_SMOOTH)
    yield from shapes.waves()
    yield shapes.own(1)


def _attachments(shapes: _Shapes, legs: tuple[int, ...]) -> Iterator[Follow]:
    yield from shapes.columns(1)
    yield from shapes.columns(_SMOOTH)
    yield from shapes.waves()
    yield from shapes.own_with_columns()
    yield from shapes.drives_squared()
    yield from shapes.products()
    if not legs:
        yield from shapes.drives(_SMOOTH)


def _sideways(shapes: _Shapes) -> Iterator[Follow]:
    yield from shapes.columns(1)
    yield shapes.own(1)
    yield shapes.own(2)


def _scale(shapes: _Shapes) -> Iterator[Follow]:
    yield from shapes.columns(1, apart_from=(TEMPERATURE,))
    yield from shapes.columns(_SMOOTH)
    yield from shapes.waves()
    yield from shapes.drives(1)


class _Shapes:
    """The functions that a campaign offers to follow."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._moved = scene.readings - scene.rho0 if scene.legs else np.zeros((len(scene.poses), 0))
        self._ranges = {name: _range(values) for name, values in _columns(scene).items()}
        self._distinct = {name: len(np.unique(values)) for name, values in _columns(scene).items()}
        self._stroke = float(np.abs(self._moved).max(initial=0.0)) or 1.0

    @property
    def lengths_apart(self) -> bool:
        """Return whether a leg's length is another thing than what its actuator moves."""
        return self._scene.lengths_apart

    def columns(self, degree: int, apart_from: Iterable[str] = ()) -> Iterator[Follow]:
        """Every column by polynomials of a degree; none where it has no more values than that."""
        for name, (centre, half) in self._ranges.items():
            if name not in apart_from and self._distinct[name] > degree:
                yield _follow((name,), (centre,), (half,), POLYNOMIAL, degree)

    def waves(self) -> Iterator[Follow]:
        """Slow waves of time, as many as the poses allow."""
        name = TIME if TIME in self._ranges else ORDER
        count = min(_WAVES, len(self._scene.poses) // POSES_PER_FUNCTION)
        if name in self._ranges and count > _SMOOTH:
            centre, half = self._ranges[name]
            yield _follow((name,), (centre,), (half,), WAVES, count)

    def own(self, degree: int) -> Follow:
        """Each leg's own drive."""
        return _follow((OWN_DRIVE,), (0.0,), (self._stroke,), POLYNOMIAL, degree)

    def own_with_columns(self) -> Iterator[Follow]:
        """Each leg's own drive times a column: a gain that follows it."""
        for name, (centre, half) in self._ranges.items():
            yield _follow((OWN_DRIVE, name), (0.0, centre), (self._stroke, half), POLYNOMIAL, 1)

    def look_back(self) -> Iterator[Follow]:
        """How far each actuator moved last, and lately: a memory; the mere direction is backlash."""
        for name in (LAST_STEP, MEMORY):
            steps = self._scene.covariates.get(name)
            if steps is not None and np.ptp(steps) > 0:
                yield _follow((name,), (0.0,), (float(np.abs(steps).max()),), POLYNOMIAL, 1)

    def drives(self, degree: int, apart_from: tuple[int, ...] = ()) -> Iterator[Follow]:
        """Every single drive."""
        for leg in range(1, self._scene.legs + 1):
            if leg not in apart_from:
                yield _follow((f"rho{leg}_mm",), (0.0,), (self._stroke,), POLYNOMIAL, degree)

    def drives_squared(self) -> Iterator[Follow]:
        """The square of every single drive."""
        for leg in range(1, self._scene.legs + 1):
            yield _follow((f"rho{leg}_mm",) * 2, (0.0, 0.0), (self._stroke,) * 2, POLYNOMIAL, 1)

    def products(self) -> Iterator[Follow]:
        """The product of every two drives."""
        for first, second in combinations(range(1, self._scene.legs + 1), 2):
            names = (f"rho{first}_mm", f"rho{second}_mm")
            yield _follow(names, (0.0, 0.0), (self._stroke,) * 2, POLYNOMIAL, 1)

    def all_drives(self) -> Follow:
        """All drives at once."""
        return _follow((), (), (self._stroke,), ALL_DRIVES, 1)

    def over_poses(self) -> Iterator[tuple[Follow, NDArray]]:
        """What a single target may follow, with the values (B,) of its one function."""
        moved = self._moved / self._stroke
        for number, follow in enumerate(self.drives(1)):
            yield follow, moved[:, number]
        for number, follow in enumerate(self.drives_squared()):
            yield follow, moved[:, number] ** 2
        for (first, second), follow in zip(combinations(range(self._scene.legs), 2), self.products(), strict=True):
            yield follow, moved[:, first] * moved[:, second]
        values = _columns(self._scene)
        for follow in self.columns(1):
            yield follow, (values[follow["columns"][0]] - follow["centres"][0]) / follow["half_ranges"][0]
        for name, (centre, half) in self._ranges.items():
            if self._distinct[name] > _SMOOTH:
                x = (values[name] - centre) / half
                yield _follow((name, name), (centre, centre), (half, half), POLYNOMIAL, 1), x**2


def target_followings(scene: Scene, make: Callable[..., Cause], scale: float) -> list[Profiles]:
    """Return what single targets may follow: by one function each drive and column, squares and products; by several
    slow waves of time."""
    shapes = _Shapes(scene)
    single = list(shapes.over_poses())
    waves = [(follow, _waves(scene, follow)) for follow in shapes.waves()]
    return [_profiles(scene, found, make, scale) for found in (single, waves) if found and len(scene.shape)]


def _profiles(scene: Scene, shapes: list[tuple[Follow, NDArray]], make: Callable[..., Cause], scale: float) -> Profiles:
    def member(target: int, shape: int) -> Cause:
        own = scene.targets
        return make(quantity="targets", body=own.bodies[target], targets=(own.names[target],), **shapes[shape][0])

    values = np.stack([values.reshape(len(values), -1) for _, values in shapes])
    seen = np.full(len(scene.shape), len(scene.poses)) if scene.seen is None else scene.seen.sum(0)
    enough = np.broadcast_to(seen >= _FEWEST_SEEN * values.shape[-1], (len(shapes), len(scene.shape)))
    return Profiles(values, np.arange(len(scene.shape)), enough, scale, member)


def _waves(scene: Scene, follow: Follow) -> NDArray:
    """Return slow waves (B, m) of the one column that they follow."""
    x = (scene.covariates[follow["columns"][0]] - follow["centres"][0]) / follow["half_ranges"][0]
    return waves(x, follow["degree"])


def _columns(scene: Scene) -> Mapping[str, NDArray]:
    """Return the columns of the configurations that vary; the order only where there is no time."""
    timed = scene.varies(TIME)
    left_out = (*LOOKING_BACK, *([ORDER] if timed else []))
    return {
        name: values
        for name, values in scene.covariates.items()
        if name not in left_out and values.ndim == 1 and np.isfinite(values).all() and scene.varies(name)
    }


def _range(values: NDArray) -> tuple[float, float]:
    return float(values.max() + values.min()) / 2, float(values.max() - values.min()) / 2


def _follow(
    columns: tuple[str, ...], centres: tuple[float, ...], half_ranges: tuple[float, ...], form: str, degree: int
) -> Follow:
    return {"columns": columns, "centres": centres, "half_ranges": half_ranges, "form": form, "degree": degree}


def _patterned(scene: Scene) -> Iterator[Follow]:
    """Return the bodies, legs apart, whose targets may move together, with places along their two longest axes."""
    for body in dict.fromkeys(scene.targets.bodies):
        own = [n for n, other in enumerate(scene.targets.bodies) if other == body]
        own = [n for n in own if not scene.targets.at_attachment[n]]
        if len(own) >= _FEWEST_PATTERNED and not body.startswith("leg"):
            away = scene.shape[own] - scene.shape[own].mean(0)
            along = away @ np.linalg.svd(away, full_matrices=False)[2][:2].T
            places = along / np.maximum(np.abs(along).max(0), 1e-9)
            names = tuple(scene.targets.names[n] for n in own)
            yield {"body": body, "targets": names, "places": tuple(float(value) for value in places.ravel())}
