"""Whether a camera stayed as it was from image to image, and what it does to object points where it did not."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.estimation.bundle.camera_settings import moved_by_settings
from truing.estimation.bundle.image_stability import image_stability
from truing.estimation.bundle.named_adjustment import AdjustedNetwork
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.photograph_artifacts import BENT, SHARED

if TYPE_CHECKING:
    import pyarrow as pa


def image_cameras(found: AdjustedNetwork) -> tuple[pa.Table, list[tuple[str, str, float, str]]]:
    """The table image_cameras, a row per image whose principal distance its rays tell; and figures: a p-value per
    camera, and by how much points of each pose move where images that differ are given a camera of their own."""
    import pyarrow as pa

    named, network = found.named, found.adjustment.network
    stable = image_stability(found.snooped.by_rays, found.snooped.components.of_rays())
    rows = [
        {
            "pose": named.poses[network.image_pose[image]],
            "image": str(named.images[image]),
            "camera": network.cameras[own.camera].name,
            "principal_distance_off_px": float(own.off_px[k]),
            "principal_distance_sigma_px": float(own.sigma_px[k]),
            "setting": int(own.setting[k]),
        }
        for own in stable
        for k, image in enumerate(own.images.tolist())
    ]
    text = any(isinstance(pose, str) for pose in named.poses)
    table = pa.Table.from_pylist(rows, schema=ARTIFACTS["image_cameras"].arrow_schema("string" if text else "int64"))
    figures = [(SHARED, network.cameras[own.camera].name, own.p_value, "1") for own in stable]
    moved = [(BENT, f"pose {named.poses[pose]}", value, "1") for pose, value in moved_by_settings(found, stable)]
    return table, figures + moved
