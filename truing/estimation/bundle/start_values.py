"""Start values of a network without the user: every image's orientation and every point, from named points alone.

Each pose is oriented for itself: from points with known coordinates where an image sees enough of them, else from the
relative orientation of two images, else from a marker of known size; the other images follow by resection and
intersection in turn, with adjustments in between that also free the principal distance. A principal distance that is
not known is tried at several field widths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.estimation.bundle.growing import Grown, grow, intersected
from truing.estimation.bundle.intersection import LEAST_ANGLE, Mask
from truing.estimation.bundle.network import Array, Index, Network, State
from truing.estimation.bundle.resection import FEWEST
from truing.estimation.bundle.start_frame import in_frame
from truing.estimation.bundle.start_refinement import joined, refined, refined_together
from truing.estimation.bundle.start_seeds import begin, usual_distance


@dataclass(frozen=True)
class Markers:
    """Square markers of known size: their corners (M, 4) as points by number, in order round the square, and the length
    of an edge size_m (M,)."""

    corners: Index
    size_m: Array

    @classmethod
    def none(cls) -> Markers:
        """No marker at all."""
        return cls(np.empty((0, 4), np.int64), np.empty(0))


@dataclass(frozen=True)
class Start:
    """Start values: the state (NaN where nothing was found), which images (I,) are oriented and points (P,) placed,
    which rays (N,) agree, why images and points were left out ("" where they were not), and per pose (S) where its
    frame and its scale come from: "known points", "scale bars", "markers", "none" (free), "not oriented"."""

    state: State
    image_oriented: Mask
    point_placed: Mask
    ray_agrees: Mask
    image_reason: tuple[str, ...]
    point_reason: tuple[str, ...]
    frame: tuple[str, ...]
    scale: tuple[str, ...]


def find_start(network: Network, interior: Array, markers: Markers | None = None) -> Start:
    """Return start values of all images and points that can be oriented.

    interior (C, 10) as known beforehand, in the order of camera.PARAMETERS: a principal distance from EXIF data or a
    calibration, NaN where nothing is known; other elements 0 where nothing is known.
    """
    markers = Markers.none() if markers is None else markers
    poses = 1 + int(max(network.image_pose.max(initial=-1), network.point_pose.max(initial=-1)))
    rays = np.bincount(network.image_pose[network.rays.image], minlength=poses)
    found: list[Grown] = []
    values = interior.copy()
    for pose in np.argsort(-rays, kind="stable").tolist():
        own = (network.point_pose == pose)[markers.corners].all(axis=1)
        found.append(begin(network, values, pose, markers.corners[own], markers.size_m[own]))
        if found[-1].oriented.any():
            used = np.unique(network.image_camera[found[-1].oriented])
            values[used] = found[-1].interior[used]
    values[:, 0] = np.where(np.isnan(values[:, 0]), usual_distance(network), values[:, 0])
    found = _finished(network, [replace(now, interior=values) for now in found])
    state, frame, scale = in_frame(network, joined(network, found), markers.corners, markers.size_m)
    agrees = np.zeros(network.rays.count, bool)
    for now in found:
        agrees[now.ray] = now.agrees
    oriented, placed = np.isfinite(state.centre[:, 0]), np.isfinite(state.points[:, 0])
    images, points = _image_reasons(network, found, oriented), _point_reasons(network, state, placed, oriented)
    return Start(state, oriented, placed, agrees, images, points, tuple(frame), tuple(scale))


def _finished(network: Network, found: Sequence[Grown]) -> list[Grown]:
    """Return all poses adjusted together, images tried again that failed before, and once more adjusted."""
    together = refined_together(network, found)
    again = []
    for number, now in enumerate(together):
        rng = np.random.default_rng(number)
        fresh = intersected(replace(now, failed={}), rng) if now.oriented.any() else now
        again.append(grow(fresh, rng, lambda grown: refined(network, grown)))
    return refined_together(network, [replace(now, interior=together[0].interior) for now in again])


def _image_reasons(network: Network, found: Sequence[Grown], oriented: Mask) -> tuple[str, ...]:
    """Return why images (I,) have no orientation, "" where they have one."""
    failed = {image: why for now in found for image, why in now.failed.items()}
    placed = np.zeros(len(network.point_pose), bool)
    for now in found:
        placed |= np.isfinite(now.X[:, 0])
    rays = network.rays
    sees = np.bincount(rays.image, minlength=len(oriented))
    sees_placed = np.bincount(rays.image[placed[rays.point]], minlength=len(oriented))
    begun = np.bincount(network.image_pose[oriented], minlength=1 + int(network.image_pose.max(initial=0))) > 0
    reasons = []
    for image in range(len(oriented)):
        if oriented[image]:
            reasons.append("")
        elif sees[image] < FEWEST:
            reasons.append(f"sees {sees[image]} points with a name, at least {FEWEST} are needed")
        elif not begun[network.image_pose[image]]:
            reasons.append(
                "no two images of its pose have enough points in common, and no image sees enough known points"
            )
        elif image in failed:
            reasons.append(f"of {failed[image][0]} points with coordinates that it sees only {failed[image][1]} agree")
        else:
            reasons.append(f"sees {sees_placed[image]} points with coordinates, at least {FEWEST} are needed")
    return tuple(reasons)


def _point_reasons(network: Network, state: State, placed: Mask, oriented: Mask) -> tuple[str, ...]:
    """Return why points (P,) have no coordinates, "" where they have them."""
    rays = network.rays
    seen = np.bincount(rays.point, minlength=len(placed))
    by_oriented = np.bincount(rays.point[oriented[rays.image]], minlength=len(placed))
    angle = f"{np.degrees(LEAST_ANGLE):.0f} degrees"
    reasons = np.where(
        by_oriented >= 2, f"its rays do not agree, or meet at less than {angle}", "seen in one oriented image"
    )
    reasons = np.where(by_oriented == 0, "seen in no oriented image", reasons)
    reasons = np.where(seen == 0, "seen in no image", reasons)
    return tuple(np.where(placed, "", reasons).tolist())
