"""What a camera does to a direction: principal distance, principal point, distortion with a balancing radius.

Frame of a camera: x to the right, y down, z forward, origin in the projection centre. Image coordinates are in pixels,
x to the right and y down, the centre of the first pixel at (0, 0). With X = (X, Y, Z) in the camera's frame:

    xi = c X / Z                  eta = c Y / Z                 r^2 = xi^2 + eta^2
    radial = A1 (r^2 - R0^2) + A2 (r^4 - R0^4) + A3 (r^6 - R0^6)
    x = x_centre + x0 + xi  + xi  radial + B1 (r^2 + 2 xi^2)  + 2 B2 xi eta + C1 xi + C2 eta
    y = y_centre + y0 + eta + eta radial + B2 (r^2 + 2 eta^2) + 2 B1 xi eta

where the centre is that of the format, ((width - 1) / 2, (height - 1) / 2). Brown (1971), with affinity C1 and shear C2
and balanced radial distortion as in Luhmann et al., Close-Range Photogrammetry and 3D Imaging (3rd ed.), section 3.3.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PARAMETERS = ("c", "x0", "y0", "A1", "A2", "A3", "B1", "B2", "C1", "C2")
UNITS = ("px", "px", "px", "px^-2", "px^-4", "px^-6", "px^-1", "px^-1", "1", "1")


@dataclass(frozen=True)
class Camera:
    """One camera: its name, its format in pixels, the balancing radius R0 in pixels (0: unbalanced), the pitch of its
    pixels in m where it is known, and which of the ten parameters are estimated."""

    name: str
    width_px: int
    height_px: int
    balancing_radius_px: float = 0.0
    pitch_m: float | None = None
    free: tuple[str, ...] = PARAMETERS

    @property
    def centre_px(self) -> NDArray[np.float64]:
        """The centre (2,) of the format in pixels."""
        return np.array([(self.width_px - 1) / 2, (self.height_px - 1) / 2])
