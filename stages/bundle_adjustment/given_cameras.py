"""The cameras of a campaign before the adjustment: what is given of them, and what photographs say themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.bundle.camera import PARAMETERS, Camera

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class GivenCameras:
    """Cameras (C), the number of each name, and their interior (C, 10) to start from, NaN where c is not known."""

    cameras: tuple[Camera, ...]
    number: dict[str, int]
    interior: NDArray[np.float64]


def given_cameras(photographs: pa.Table, given: pa.Table | None) -> GivenCameras:
    """The cameras that took any photograph, in order of appearance."""
    rows = photographs.to_pylist()
    known: dict[str, list[dict[str, Any]]] = {}
    for row in [] if given is None else given.to_pylist():
        known.setdefault(row["camera"], []).append(row)
    names = list(dict.fromkeys(row["camera"] for row in rows))
    cameras, interior = [], np.zeros((len(names), len(PARAMETERS)))
    for number, name in enumerate(names):
        own = [row for row in rows if row["camera"] == name]
        told = known.get(name, [])
        cameras.append(_camera(name, own[0], told))
        if told:
            interior[number] = [row["value"] if row["value"] is not None else np.nan for row in told]
        else:
            interior[number, 0] = np.nan
        if np.isnan(interior[number, 0]):
            said = [row["principal_distance_px"] for row in own if row["principal_distance_px"]]
            interior[number, 0] = np.median(said) if said else np.nan
    return GivenCameras(tuple(cameras), {name: n for n, name in enumerate(names)}, interior)


def _camera(name: str, photograph: dict[str, Any], told: list[dict[str, Any]]) -> Camera:
    first = told[0] if told else {}
    width, height = (first.get(key) or photograph[key] for key in ("width_px", "height_px"))
    radius = first.get("balancing_radius_px") or (float(np.hypot(width, height) / 3) if not told else 0.0)
    pitch = 1e-6 * first["pixel_um"] if first.get("pixel_um") else None
    free = tuple(row["parameter"] for row in told if row["free"]) if told else PARAMETERS
    return Camera(name, int(width), int(height), radius, pitch, free)
