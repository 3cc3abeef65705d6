"""Conversion of interior orientations of other programs to the columns of the table ``cameras``.

Target model: principal distance c, principal point from the centre of the format, polynomials in px of the ideal image
coordinates (equations: truing/estimation/bundle/camera.py); balanced about R0, 0 for programs without balancing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from truing.formats.raw import Unusable

Row = Mapping[str, str | int | float | None]

_NAMES = ("focal_px", "x0_px", "y0_px", "A1", "A2", "A3", "B1", "B2", "C1", "C2")
_LARGEST_FORMAT = 1_000_000  # pixels
CORNER = 0.5  # pixel coordinate of the first pixel's centre in programs that count from its corner


def camera_row(
    camera: str,
    size: tuple[int, int],
    values: Sequence[float],
    *,
    radius_px: float = 0.0,
    pixel_um: float | None = None,
) -> Row:
    """Return a row of ``cameras``: ten values in px, in the order c x0 y0 A1 A2 A3 B1 B2 C1 C2.

    Raises Unusable for an impossible format, and for values that are not finite.
    """
    if not 0 < min(size) <= max(size) <= _LARGEST_FORMAT:
        raise Unusable(
            f"a format from 1 to {_LARGEST_FORMAT} pixels", column="width_px", value=f"{size[0]} x {size[1]}"
        )
    if not np.isfinite([*values, radius_px, pixel_um or 0.0]).all():
        raise Unusable("an interior orientation in finite numbers", column="focal_px", value=camera)
    return {
        "camera": camera,
        "width_px": size[0],
        "height_px": size[1],
        "pixel_um": pixel_um,
        "balancing_radius_px": radius_px,
        **dict(zip(_NAMES, map(float, values), strict=True)),
    }


def from_pinhole(
    focal: tuple[float, float], point: tuple[float, float], size: tuple[int, int], distortion: Sequence[float]
) -> list[float]:
    """Return the ten values of a camera that divides by its focal lengths before distortion: (k1, k2, k3, p1, p2).

    ``focal`` and ``point`` in px, the first pixel's centre at (0.5, 0.5). If fx differs from fy, C1 carries the ratio:
    exact for the undistorted image, and to (fx / fy - 1) times the distortion for the rest.
    """
    (fx, fy), (k1, k2, k3, p1, p2) = focal, distortion
    centre = ((size[0] - 1) / 2, (size[1] - 1) / 2)
    x0, y0 = (point[axis] - CORNER - centre[axis] for axis in (0, 1))
    return [fy, x0, y0, k1 / fy**2, k2 / fy**4, k3 / fy**6, p2 / fy, p1 / fy, fx / fy - 1.0, 0.0]


def from_millimetres(values: Sequence[float], pitch_mm: float) -> list[float]:
    """Return the ten values of a camera given in mm with y upwards and positive distance c.

    Lengths become px by one pitch for both axes, for square pixels; C1 keeps the deviation.
    """
    c, x0, y0, a1, a2, a3, b1, b2, c1, c2 = values
    p = pitch_mm
    return [c / p, x0 / p, -y0 / p, a1 * p**2, a2 * p**4, a3 * p**6, b1 * p, -b2 * p, c1, -c2]


def from_corrections(
    c: float, point: tuple[float, float], size: tuple[float, float], corrections: Sequence[float]
) -> list[float]:
    """Return the ten values of a camera with polynomials (K1, K2, K3, P1, P2) that correct measured coordinates about
    its principal point.

    Lengths in any common unit, y downwards, ``point`` from the centre of a format of ``size``. Our polynomials distort
    ideal coordinates instead; their coefficients are fitted over the format.
    """
    k1, k2, k3, p1, p2 = corrections
    grid = np.stack(np.meshgrid(*(np.linspace(-0.5, 0.5, 21) * length for length in size)), axis=-1).reshape(-1, 2)
    measured = grid - point
    x, y = measured.T
    r2 = x**2 + y**2
    radial = k1 * r2 + k2 * r2**2 + k3 * r2**3
    x, y = (
        x + x * radial + p1 * (r2 + 2 * x**2) + 2 * p2 * x * y,
        y + y * radial + p2 * (r2 + 2 * y**2) + 2 * p1 * x * y,
    )
    r2 = x**2 + y**2
    design = np.concatenate(
        [
            np.stack([x * r2, x * r2**2, x * r2**3, r2 + 2 * x**2, 2 * x * y], axis=1),
            np.stack([y * r2, y * r2**2, y * r2**3, 2 * x * y, r2 + 2 * y**2], axis=1),
        ]
    )
    scale = np.linalg.norm(design, axis=0)
    shift = np.concatenate([measured[:, 0] - x, measured[:, 1] - y])
    coefficients = np.linalg.lstsq(design / scale, shift, rcond=None)[0] / scale
    return [c, *point, *coefficients.tolist(), 0.0, 0.0]
