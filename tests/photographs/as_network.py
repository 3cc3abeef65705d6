"""A photographed campaign as network for the adjustment, with the truth as start values."""

from __future__ import annotations

import numpy as np

from tests.blind.generator.quaternions import rotate
from tests.photographs.lens import Lens
from tests.photographs.rays import Photographed, true_turns
from truing.estimation.bundle.camera import Camera
from truing.estimation.bundle.network import Bars, KnownPoints, Network, NetworkState, Rays


def network_of(photographed: Photographed) -> tuple[Network, NetworkState]:
    """The rays that are not grossly wrong, in m; images count pose by pose, points likewise."""
    poses, stations = photographed.views.centre.shape[:2]
    kept = ~photographed.gross
    image = photographed.pose[kept] * stations + photographed.station[kept]
    number, point = np.unique(
        photographed.pose[kept] * len(photographed.names) + photographed.point[kept], return_inverse=True
    )
    pixel = photographed.pixel[kept]
    sigma = photographed.shooting.stated_sigma_px or photographed.shooting.sigma_px
    rays = Rays(
        image,
        point,
        np.column_stack([pixel.real, pixel.imag]),
        np.broadcast_to(np.eye(2) * sigma**2, (len(image), 2, 2)).copy(),
        np.zeros(len(image), np.int64),
    )
    network = Network(
        tuple(_camera(lens) for lens in photographed.shooting.lenses),
        np.tile(np.arange(stations) % len(photographed.shooting.lenses), poses),
        np.repeat(np.arange(poses), stations),
        number // len(photographed.names),
        rays,
        _bars(photographed, number),
        KnownPoints.none(),
    )
    axes = rotate(true_turns(photographed)[:, :, None], np.eye(3))  # the camera's axes in the scene, by the row
    state = NetworkState(
        np.array([interior_of(lens) for lens in photographed.shooting.lenses]),
        np.swapaxes(axes, -1, -2).reshape(-1, 3, 3),
        photographed.views.centre.reshape(-1, 3) * 1e-3,
        photographed.points.reshape(-1, 3)[number] * 1e-3,
        network.bars.length_m.copy(),
    )
    return network, state


def _camera(lens: Lens) -> Camera:
    free = ("c", "x0", "y0", "A1", "A2", "B1", "B2", "C1", "C2")
    return Camera(lens.name, lens.width_px, lens.height_px, free=free)


def interior_of(lens: Lens) -> list[float]:
    f = lens.focal_px
    radial = [k / f ** (2 * n) for n, k in enumerate(lens.radial, 1)]
    of = [f, lens.principal_px.real, lens.principal_px.imag, *radial]
    return [*of, lens.decentring.real / f, lens.decentring.imag / f, lens.stretch, lens.shear]


def _bars(photographed: Photographed, number: np.ndarray) -> Bars:
    bars, count = photographed.shooting.bars, len(photographed.names)
    rows = []
    for pose in range(len(photographed.points)):
        for k in range(len(bars)):
            ends = pose * count + count - 2 * len(bars) + 2 * k + np.arange(2)
            places = np.searchsorted(number, ends)
            if np.all(places < len(number)) and np.all(number[np.minimum(places, len(number) - 1)] == ends):
                rows.append((k, *places))
    found = np.array(rows, np.int64).reshape(-1, 3)
    repeat = np.array([bar.repeat_mm for bar in bars]) * 1e-3
    sigma = np.array([bar.sigma_mm for bar in bars]) * 1e-3
    lengths = photographed.calibrated_mm * 1e-3
    return Bars(found[:, 0], found[:, 1], found[:, 2], repeat[found[:, 0]], lengths, sigma)
