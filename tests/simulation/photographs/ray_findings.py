"""Simulated statistics of rays on a camera, two bars and the air in some poses, without a network."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.inference.observations import Epochs, Frames, Observations
from truing.simulation.photographs.ray_poses import RayParameter, RayPoses

NUMBERS = (
    *(RayParameter("air", "", name, "1/m^2", 1e-6, 0.0) for name in ("xx", "yy", "zz", "xy", "xz", "yz")),
    RayParameter("window", "left", "thickness", "m", 1e-3, 0.0),
    *(RayParameter("bar", bar, "strain", "1", 1e-5, 1e-5) for bar in ("S", "T")),
    *(RayParameter("camera", "left", name, "px", 1.0, None) for name in ("x0", "y0", "c")),
)
# One standard deviation of each number in one pose, were all others known; of the bars only the difference is known.
SIGMAS = np.array([*[2e-6] * 6, 5e-3, 1e-5, 1e-5, 0.1, 0.1, 0.15]) / [number.scale for number in NUMBERS]
POSES = 24


def ray_poses(seed: int) -> RayPoses:
    """24 poses whose rays determine the numbers with small correlations."""
    rng = np.random.default_rng(seed)
    mixed = np.triu(0.3 * rng.normal(size=(POSES, len(NUMBERS), len(NUMBERS))), 1) + np.eye(len(NUMBERS))
    root = mixed / SIGMAS
    bars = [place for place, number in enumerate(NUMBERS) if number.kind == "bar"]
    root[:, :, bars[1]] = -root[:, :, bars[0]]
    root[:, bars[1]] = 0.0
    is_observed = np.ones(root.shape[:2], bool)
    is_observed[:, bars[1]] = False
    warm = 20.0 + np.cumsum(rng.normal(0.0, 0.3, POSES))
    time = 240.0 * np.arange(POSES)
    columns = {
        "time_s": time,
        "temperature_c": warm,
        "order": np.arange(POSES) * 1.0,
        "rho1_mm": rng.normal(size=POSES),
    }
    up = np.tile([0.0, 0.0, 1.0], (POSES, 1))
    names = tuple(number.called for number in NUMBERS)
    return RayPoses(
        tuple(range(1, POSES + 1)), NUMBERS, names, root, is_observed, columns, (0.0, float(time[-1])), 20.0, up
    )


def measured_epochs(rays: RayPoses, off: NDArray, seed: int) -> Epochs:
    """Epochs measured by rays, with numbers (B, T) off by given multiples of their scales."""
    noise = np.random.default_rng([seed, 1]).standard_normal(rays.root.shape[:2])
    values = np.einsum("bkt,bt->bk", rays.root, off) + noise * rays.is_observed
    measured = Observations(values[..., None], np.ones((*values.shape, 1, 1)), rays.is_observed)
    return Epochs(measured, rays, Frames.of_numbers(len(rays.poses)))


def place(name: str) -> int:
    """Index of a number."""
    return [number.called for number in NUMBERS].index(name)
