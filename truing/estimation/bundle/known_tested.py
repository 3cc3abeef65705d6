"""Known points against the rays, before they become the datum: one that contradicts these rejects no ray."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.known_points import KnownPointErrors, known_point_errors
from truing.estimation.bundle.network import Index, Network, State
from truing.estimation.bundle.snooping import Snooped

_LOOSE = 0.1  # of the extent of the known points: a coordinate that gives a frame and contradicts nothing
_FEWEST = 3
_FLAT = 0.01  # of their extent: known points nearer to one line give no frame


@dataclass(frozen=True)
class KnownTested:
    """Per pose, by its number: which known points (rows of network.known) were tested, and with what result."""

    rows: Mapping[int, Index] = field(default_factory=dict)
    errors: Mapping[int, KnownPointErrors] = field(default_factory=dict)

    def consistent(self, network: Network) -> Network:
        """The network without known points that are wrong; where nobody can say which, all are known less well."""
        known = network.known
        kept, cov = np.ones(len(known.point), bool), known.cov_m2.copy()
        for pose, rows in self.rows.items():
            kept[rows[self.errors[pose].wrong]] = False
            cov[rows] *= self.errors[pose].inflation
        return replace(
            network, known=replace(known, point=known.point[kept], xyz_m=known.xyz_m[kept], cov_m2=cov[kept])
        )


def loosened(network: Network, state: State) -> Network:
    """The network with known points that give each pose a frame, and hardly more."""
    known = network.known
    cov = known.cov_m2.copy()
    for rows in _rows_by_pose(network, state).values():
        xyz = known.xyz_m[rows]
        extent = np.sqrt(np.mean(np.sum((xyz - xyz.mean(0)) ** 2, -1)))
        cov[rows] += (_LOOSE * extent) ** 2 * np.eye(3)
    return replace(network, known=replace(known, cov_m2=cov))


def tested_known(network: Network, loose: Snooped) -> KnownTested:
    """What rays say of the known points, from an adjustment in which these hardly hold."""
    adjusted = loose.adjustment
    covariance, factor = adjusted.covariance, loose.covariance_factor if np.isfinite(loose.covariance_factor) else 1.0
    tested: dict[int, Index] = {}
    errors: dict[int, KnownPointErrors] = {}
    seen = np.bincount(network.rays.point[adjusted.used], minlength=len(network.point_pose))
    for pose, rows in _rows_by_pose(network, adjusted.state).items():
        number = network.known.point[rows]
        rows = rows[seen[number] >= 2]
        if len(rows) < _FEWEST or _is_line(network.known.xyz_m[rows]):
            continue
        number = network.known.point[rows]
        place = [int(np.flatnonzero(covariance.point_numbers(pose) == point)[0]) for point in number]
        own = (3 * np.array(place)[:, None] + np.arange(3)).ravel()
        cov = covariance.points(pose)[np.ix_(own, own)] * factor
        known = network.known
        tested[pose] = rows
        errors[pose] = known_point_errors(adjusted.state.points[number], cov, known.xyz_m[rows], known.cov_m2[rows])
    return KnownTested(tested, errors)


def _is_line(xyz: NDArray[np.float64]) -> bool:
    sizes = np.linalg.svd(xyz - xyz.mean(0), compute_uv=False)
    return bool(sizes[1] < _FLAT * sizes[0])


def _rows_by_pose(network: Network, state: State) -> dict[int, Index]:
    known = network.known
    pose, there = network.point_pose[known.point], np.isfinite(state.points[known.point, 0])
    return {int(number): np.flatnonzero((pose == number) & there) for number in np.unique(pose[there])}
