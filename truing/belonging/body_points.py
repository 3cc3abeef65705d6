"""Measured points of one body as arrays, also paired with the surveys of other bodies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.belonging.target_names import NamedTargets


@dataclass(frozen=True)
class AsOtherBody:
    """Points (B, K, 3), m, of a body in each pose, is_observed (B, K), paired with the survey (K, 3) of another
    body ``name``.

    They are paired by the names of targets, or by their places in the file.
    """

    name: str
    survey: Array
    points: Array
    is_observed: Mask

    def subset(self, rows: Index) -> AsOtherBody:
        """Return them in some poses."""
        return replace(self, points=self.points[rows], is_observed=self.is_observed[rows])


@dataclass(frozen=True)
class BodyPoints:
    """One body: survey (T, 3) and points (B, T, 3) in m, is_observed (B, T), sigma of a coordinate in m: that of
    the scatter, which is noise_factor times the declared one.

    ``poses`` (B,) in the order of the file; ``groups``: columns that group poses, with their values; ``others``: the
    recorded points paired with the surveys of other bodies; ``targets`` (T,): their names; ``named``: all targets, also
    those that define no frame.
    """

    name: str
    survey: Array
    points: Array
    is_observed: Mask
    sigma: float
    poses: tuple[str, ...] = ()
    groups: tuple[tuple[str, tuple[str, ...]], ...] = ()
    others: tuple[AsOtherBody, ...] = ()
    noise_factor: float = 1.0
    targets: tuple[str, ...] = ()
    named: NamedTargets | None = None

    def subset(self, rows: Index) -> BodyPoints:
        """Return the body in some poses."""
        names = tuple(self.poses[row] if self.poses else str(row) for row in rows.tolist())
        groups = tuple((name, tuple(np.asarray(labels)[rows].tolist())) for name, labels in self.groups)
        others = tuple(other.subset(rows) for other in self.others)
        return replace(
            self,
            points=self.points[rows],
            is_observed=self.is_observed[rows],
            poses=names,
            groups=groups,
            others=others,
        )
