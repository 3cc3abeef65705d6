"""Lens and image format: from directions to pixels and back, with directions as complex numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.quaternions import Array, rotate

Complex = NDArray[np.complex128]
ROUNDS = 12
ENOUGH = 1e-12  # of a tangent: far below a thousandth of a pixel


@dataclass(frozen=True)
class Lens:
    """Format in pixels, focal length in pixels, principal point from the format's centre in pixels, radial
    coefficients of |w|^2, |w|^4, |w|^6, decentring (one complex number), and what the axes have of scale and shear.

    A direction w = (X + iY) / Z is imaged at focal (w (1 + radial) + decentring |w|^2 + 2 w Re(conj(decentring) w) +
    stretch Re w + shear Im w), counted from the principal point.
    """

    name: str = "camera"
    width_px: int = 1600
    height_px: int = 1200
    focal_px: float = 2250.0
    principal_px: complex = 6.3 - 4.1j
    radial: tuple[float, float, float] = (-0.09, 0.11, 0.0)
    decentring: complex = 2.1e-4 - 1.4e-4j
    stretch: float = 1.2e-4
    shear: float = -0.6e-4
    pitch_um: float = 4.8

    @property
    def origin_px(self) -> complex:
        """Principal point, from the centre of the first pixel, px."""
        return complex((self.width_px - 1) / 2, (self.height_px - 1) / 2) + self.principal_px

    def image_of(self, w: Complex) -> Complex:
        """Pixels x + iy of directions w."""
        return self.origin_px + self.focal_px * self.distorted(w)

    def distorted(self, w: Complex) -> Complex:
        """Distorted directions of w, in units of the focal length."""
        square = w.real**2 + w.imag**2
        k1, k2, k3 = self.radial
        along = (np.conj(self.decentring) * w).real
        return (
            w * (1 + square * (k1 + square * (k2 + square * k3)))
            + self.decentring * square
            + 2 * w * along
            + (self.stretch * w.real + self.shear * w.imag)
        )

    def direction_of(self, pixel: Complex) -> Complex:
        """Directions w that are imaged at pixels x + iy; a contraction, as distortion is small."""
        wanted = (pixel - self.origin_px) / self.focal_px
        w = wanted.copy()
        for _ in range(ROUNDS):
            miss = wanted - self.distorted(w)
            w += miss
            if np.max(np.abs(miss), initial=0.0) < ENOUGH:
                break
        return w

    def inside(self, pixel: Complex, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Return True for pixels inside the format by at least a margin."""
        x, y = pixel.real, pixel.imag
        right, below = self.width_px - 1 - margin_px, self.height_px - 1 - margin_px
        return (x >= margin_px) & (x <= right) & (y >= margin_px) & (y <= below)


@dataclass(frozen=True)
class View:
    """Cameras as they stand: turn (..., 4) takes vectors of the scene into the camera's axes, centre (..., 3), mm."""

    turn: Array
    centre: Array

    def seen(self, points: Array) -> Array:
        """Points (..., 3) of the scene in the camera's axes."""
        return rotate(self.turn, points - self.centre)


def direction(seen: Array) -> Complex:
    """Direction w of points (..., 3) in a camera's axes."""
    return (seen[..., 0] + 1j * seen[..., 1]) / seen[..., 2]
