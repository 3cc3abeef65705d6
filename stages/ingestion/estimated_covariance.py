"""Standard deviations of adjusted points that come without any: from their rays, by the bundle adjustment."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.numbers import count as counted

if TYPE_CHECKING:
    from truing.estimation.bundle.network import Array
    from truing.formats.colmap_network import ColmapNetwork

MOST_POINTS = 1500  # whose covariance is found as a whole


@dataclass
class EstimatedCovariance:
    """The estimate, and what is to be said of it. A file that is read twice is adjusted once."""

    said: list[str] = field(default_factory=list)
    found: dict[bytes, Array | None] = field(default_factory=dict)

    def __call__(self, network: ColmapNetwork) -> Array | None:
        """The covariances (P, 3, 3) of a model's points, in its own unit; None where they cannot be known."""
        key = network.points.tobytes() + network.ray_px.tobytes()
        if key not in self.found:
            self.found[key] = self._estimated(network)
        return self.found[key]

    def _estimated(self, network: ColmapNetwork) -> Array | None:
        count = len(network.points)
        if count > MOST_POINTS:
            self.said.append(
                f"no standard deviations of {counted(count, 'point')} without any: more than {MOST_POINTS:,}"
            )
            return None
        try:
            with np.errstate(all="ignore"):  # whatever a damaged model holds
                found, sigma_px = _covariance(network)
        except (ValueError, np.linalg.LinAlgError):
            self.said.append(f"no standard deviations of {counted(count, 'point')}: their rays do not determine them")
            return None
        known = int(np.isfinite(found[:, 0, 0]).sum())
        self.said.append(
            f"standard deviations of {counted(known, 'point')} estimated from their rays (noise {sigma_px:.2g} px "
            "by their residuals; free datum, without a scale)"
        )
        return found


def _covariance(found: ColmapNetwork) -> tuple[Array, float]:
    """Covariances (P, 3, 3) and the noise of an image coordinate in px, which the residuals tell."""
    from truing.estimation.bundle.adjustment import adjust
    from truing.estimation.bundle.camera import PARAMETERS, Camera
    from truing.estimation.bundle.determinable import determinable
    from truing.estimation.bundle.network import Bars, KnownPoints, Network, Rays, State

    rows: list[Any] = found.cameras
    cameras = tuple(
        Camera(row["camera"], row["width_px"], row["height_px"], 0.0, None, tuple(row["free"].split())) for row in rows
    )
    images, points, rays = len(found.image_camera), len(found.points), len(found.ray_image)
    network = Network(
        cameras,
        found.image_camera,
        np.zeros(images, np.int64),
        np.zeros(points, np.int64),
        Rays(
            found.ray_image,
            found.ray_point,
            found.ray_px,
            np.broadcast_to(np.eye(2), (rays, 2, 2)),
            np.zeros(rays, np.int64),
        ),
        Bars.none(),
        KnownPoints.none(),
    )
    names = ("focal_px", "x0_px", "y0_px", *PARAMETERS[3:])
    interior = np.array([[row[name] for name in names] for row in rows], dtype=float)
    state = State(interior, found.R, found.centre, found.points, np.empty(0))
    adjusted = adjust(network, state, "free", used=determinable(network).rays)
    if not adjusted.redundancy > 0:
        raise ValueError(f"found redundancy {adjusted.redundancy}, expected more than none")
    return adjusted.covariance.point_blocks() * adjusted.variance_factor, float(np.sqrt(adjusted.variance_factor))
