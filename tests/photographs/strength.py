"""Strength of an effect in rays: the part that other points, stations, lenses or bars cannot absorb."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.campaign import Move
from tests.blind.generator.effects import Effect
from tests.blind.generator.quaternions import Array, compose, from_vector
from tests.photographs.hidden import CameraEffect
from tests.photographs.lens import Lens, View, direction
from tests.photographs.rays import Photographed, Shooting, draw_rays

STEP_MM, STEP_RAD = 1e-3, 1e-6
RIGID_MM = 1e-4  # by which two ends of a bar may be off
STEP_PX, STEP_LENS = 1e-2, 1e-6
LOOSE = 1e-11  # of the squares: what is smaller is the frame of a pose, which nothing holds


@dataclass(frozen=True)
class RayMeasure:
    """A campaign as planned, without noise, and how its rays follow everything that an adjustment estimates."""

    shooting: Shooting
    moves: Sequence[Move]
    seed: int

    def photographed(self, effects: Sequence[CameraEffect], machine: Sequence[Effect] = ()) -> Photographed:
        """The campaign with effects."""
        return draw_rays(self.shooting, self.moves, machine, effects, np.random.default_rng(self.seed))

    def strength(self, effect: CameraEffect) -> float:
        """Root of the non-centrality that the effect has in rays and bars, after all that an adjustment estimates."""
        still = replace(self.shooting, sigma_px=0.0, missing_share=0.0, gross_share=0.0)
        plain, changed = (replace(self, shooting=still).photographed(own) for own in ((), (effect,)))
        rows = np.concatenate([self._of_pose(plain, changed, pose) for pose in range(len(plain.points))])
        lengths = np.array([bar.sigma_mm for bar in self.shooting.bars])
        prior = np.zeros((len(lengths), rows.shape[1]))
        prior[:, rows.shape[1] - 1 - len(lengths) : -1] = np.diag(1 / lengths)
        whole = np.concatenate([rows, prior])
        shared, shift = whole[:, :-1], whole[:, -1]
        scale = np.maximum(np.linalg.norm(shared, axis=0), 1e-300)
        best = np.linalg.lstsq(shared / scale, shift, rcond=1e-12)[0]
        return float(np.linalg.norm(shift - shared / scale @ best))

    def _of_pose(self, plain: Photographed, changed: Photographed, pose: int) -> Array:
        """Rows of one pose, free of its own points and stations: by lenses and bars' lengths, then the shift."""
        lenses = plain.shooting.lenses
        station, point, shift = shift_of(plain, changed, pose)
        view, points = View(plain.views.turn[pose], plain.views.centre[pose]), plain.points[pose]

        def seen(view: View = view, points: Array = points, lenses: tuple[Lens, ...] = lenses) -> Array:
            return pixels(view, points, lenses)[station, point].ravel()

        here, rays, stations = seen(), np.arange(2 * len(station)), len(view.centre)
        local = np.zeros((len(rays), 6 * stations + 3 * len(points)))
        of_station, of_point = np.repeat(station, 2), np.repeat(point, 2)
        for k, axis in enumerate(np.eye(3)):
            spin = from_vector(np.broadcast_to(STEP_RAD * axis, view.centre.shape))
            moved = seen(view=replace(view, centre=view.centre + STEP_MM * axis))
            turned = seen(view=replace(view, turn=compose(spin, view.turn)))
            local[rays, 6 * of_station + k] = (moved - here) / STEP_MM
            local[rays, 6 * of_station + 3 + k] = (turned - here) / STEP_RAD
            shifted = seen(points=points + STEP_MM * axis)
            local[rays, 6 * stations + 3 * of_point + k] = (shifted - here) / STEP_MM
        shared = [
            seen(lenses=(*lenses[:n], other, *lenses[n + 1 :])) - here
            for n, lens in enumerate(lenses)
            for other in stepped(lens)
        ]
        none = np.zeros((len(rays), len(plain.shooting.bars)))
        rows = np.column_stack([local, *shared, none, shift.ravel()]) / self.shooting.sigma_px
        rows = np.concatenate([rows, bar_rows(plain, points, stations, rows.shape[1])])
        own, left = rows[:, : local.shape[1]], rows[:, local.shape[1] :]
        own = own / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        value, vectors = np.linalg.eigh(own.T @ own)
        kept = value > LOOSE * value[-1]
        basis = own @ (vectors[:, kept] / np.sqrt(value[kept]))
        return np.asarray(left - basis @ (basis.T @ left))


def shift_of(plain: Photographed, changed: Photographed, pose: int) -> tuple[Array, Array, Array]:
    """Stations and points of the rays that both campaigns have of a pose, and by how many pixels (R, 2) they differ."""
    stations = int(plain.station.max()) + 1
    own, other = ((made.pose == pose) for made in (plain, changed))
    keys = [made.point[rows] * stations + made.station[rows] for made, rows in ((plain, own), (changed, other))]
    both, first, second = np.intersect1d(*keys, return_indices=True)
    off = changed.pixel[other][second] - plain.pixel[own][first]
    return both % stations, both // stations, np.stack([off.real, off.imag], -1)


def pixels(view: View, points: Array, lenses: tuple[Lens, ...]) -> Array:
    """Pixels (S, M, 2) of one pose."""
    w = direction(View(view.turn[:, None], view.centre[:, None]).seen(points[None]))
    pixel = np.stack([lenses[s % len(lenses)].image_of(w[s]) for s in range(len(w))])
    return np.stack([pixel.real, pixel.imag], -1)


def bar_rows(plain: Photographed, points: Array, stations: int, width: int) -> Array:
    """Rows of the bars: the distance of its ends is its length, which is one unknown for all poses."""
    bars = len(plain.shooting.bars)
    rows = np.zeros((bars, width))
    for k in range(bars):
        first = len(points) - 2 * bars + 2 * k
        along = points[first + 1] - points[first]
        along = along / np.linalg.norm(along)
        rows[k, 6 * stations + 3 * first :][:6] = np.concatenate([-along, along])
        rows[k, width - 1 - bars + k] = -1.0
    return rows / RIGID_MM


def stepped(lens: Lens) -> list[Lens]:
    """The lens with each of its numbers a step further."""
    first, second, third = lens.radial
    return [
        replace(lens, focal_px=lens.focal_px + STEP_PX),
        *(replace(lens, principal_px=lens.principal_px + STEP_PX * way) for way in (1, 1j)),
        replace(lens, radial=(first + STEP_LENS, second, third)),
        replace(lens, radial=(first, second + STEP_LENS, third)),
        *(replace(lens, decentring=lens.decentring + STEP_LENS * way) for way in (1, 1j)),
        replace(lens, stretch=lens.stretch + STEP_LENS),
        replace(lens, shear=lens.shear + STEP_LENS),
    ]
