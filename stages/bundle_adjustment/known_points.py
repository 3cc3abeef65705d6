"""Known points against the rays, before they become the datum: one that contradicts these rejects no ray."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.known_points import KnownPointErrors
from truing.estimation.bundle.known_tested import KnownTested
from truing.estimation.bundle.named_adjustment import KnownElsewhereError
from truing.estimation.bundle.named_network import NamedNetwork
from truing.estimation.bundle.network import Network
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import Fault

if TYPE_CHECKING:
    import pyarrow as pa

WRONG = "contradicts the rays"
NO_RAY = "none of its rays is left"
UNRESOLVED = "contradicts the rays or other known points; which is wrong cannot be told"


def known_points_table(named: NamedNetwork, network: Network, found: KnownTested, used: NDArray[np.bool_]) -> pa.Table:
    """The table known_point_errors: a row per known point with rays in the network as it was given."""
    import pyarrow as pa

    left = np.bincount(network.rays.point[used[: network.rays.count]], minlength=len(network.point_pose))
    seen = np.bincount(network.rays.point, minlength=len(network.point_pose))
    told = {row: (errors, place) for pose, errors in found.errors.items() for place, row in _places(found, pose)}
    rows = []
    for row, point in enumerate(network.known.point.tolist()):
        if not seen[point]:
            continue
        about = _about(*told[row]) if row in told else {"rejected": False, "reason": None}
        if not left[point]:
            about |= {"rejected": True, "reason": about["reason"] or NO_RAY}
        pose = named.poses[network.point_pose[point]]
        rows.append({"pose": pose, "point": str(named.points[point]), "rays": int(left[point]), **about})
    text = any(isinstance(pose, str) for pose in named.poses)
    schema = ARTIFACTS["known_point_errors"].arrow_schema("string" if text else "int64")
    return pa.Table.from_pylist(rows, schema=schema)


def _places(found: KnownTested, pose: int) -> list[tuple[int, int]]:
    return [(place, int(row)) for place, row in enumerate(found.rows[pose])]


def _about(errors: KnownPointErrors, place: int) -> dict[str, Any]:
    """What the rays say of one known point, in mm."""
    wrong = bool(errors.wrong[place])
    reason = WRONG if wrong else None if errors.resolved else UNRESOLVED
    if not np.isfinite(errors.p_value[place]):
        return {"rejected": wrong, "reason": reason}
    off = {f"d{axis}_mm": 1e3 * float(value) for axis, value in zip("xyz", errors.off_m[place], strict=True)}
    known = np.isfinite(errors.T[place])
    spread = [1e3 * float(value) if known else None for value in errors.sigma_m[place]]
    sigma = {f"sigma_{axis}_mm": value for axis, value in zip("xyz", spread, strict=True)}
    return {**off, **sigma, "p_value": float(errors.p_value[place]), "rejected": wrong, "reason": reason}


def faults_of(error: KnownElsewhereError) -> list[Fault]:
    """A fault per pose whose known points are of another object."""
    return [
        Fault(
            "known_points",
            f"coordinates of points as the rays of pose {one.pose} show them: is their frame, unit or name another?",
            column="x_mm, y_mm, z_mm",
            value=f"{one.elsewhere} of {one.known} elsewhere, {one.furthest} by {1e3 * one.off_m:.3g} mm",
        )
        for one in error.poses
    ]
