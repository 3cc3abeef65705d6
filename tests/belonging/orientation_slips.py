"""Measured poses of random arms, written by hand formulas; shares no code with what finds slips in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

COUNT = 30
TURN = {
    "X": lambda c, s: [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]],
    "Y": lambda c, s: [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
    "Z": lambda c, s: [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
}


def about(axis: str, angle: float) -> np.ndarray:
    """Rotation (3, 3) about a coordinate axis."""
    return np.array(TURN[axis](np.cos(angle), np.sin(angle)))


def angles_of(R: np.ndarray, order: str) -> list[float]:
    """Angles, rad, about turned axes of a rotation (3, 3)."""
    if order == "ZYX":
        return [np.arctan2(R[1, 0], R[0, 0]), -np.arcsin(R[2, 0]), np.arctan2(R[2, 1], R[2, 2])]
    if order == "XYZ":
        return [np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(R[0, 2]), np.arctan2(-R[0, 1], R[0, 0])]
    if order == "ZYZ":
        return [np.arctan2(R[1, 2], R[0, 2]), np.arccos(R[2, 2]), np.arctan2(R[2, 1], -R[2, 0])]
    assert order == "ZXZ"
    return [np.arctan2(R[0, 2], -R[1, 2]), np.arccos(R[2, 2]), np.arctan2(R[2, 0], R[2, 1])]


def read(numbers: np.ndarray, order: str) -> np.ndarray:
    """Rotations (B, 3, 3) of angles (B, 3), rad, about turned axes."""
    return np.array([np.linalg.multi_dot([about(a, v) for a, v in zip(order, row, strict=True)]) for row in numbers])


@dataclass(frozen=True)
class MeasuredArm:
    """Links R (B, 3, 3), t (B, 3), m, by the chain, and as measured on a base with a tool."""

    links: np.ndarray
    by_chain: np.ndarray
    measured: np.ndarray
    seen: np.ndarray


def arm(seed: int, travel: float = 1.3) -> MeasuredArm:
    """An arm of six axes with links, base and tool of its own, off by hundredths of a degree and millimetres."""
    rng = np.random.default_rng(seed)
    axes, links = rng.permutation(["Z", "Y", "Y", "X", "Y", "X"]), rng.uniform(0.1, 0.5, (6, 3))
    base, tool = (read(rng.uniform(-3.0, 3.0, (1, 3)), "ZYZ")[0] for _ in range(2))
    origin, lever = rng.uniform(-1.0, 1.0, 3), rng.uniform(-0.1, 0.1, 3)
    found = []
    for angles in rng.uniform(-travel, travel, (COUNT, 6)):
        R, t = np.eye(3), np.zeros(3)
        for axis, angle, link in zip(axes, angles, links, strict=True):
            R = R @ about(axis, angle)
            t = t + R @ link
        error = read(1e-3 * rng.normal(size=(1, 3)), "XYZ")[0]
        found.append((R, t, base @ R @ error @ tool, base @ (t + R @ lever) + origin + 1e-3 * rng.normal(size=3)))
    parts = [np.array(part) for part in zip(*found, strict=True)]
    return MeasuredArm(parts[0], parts[1], parts[2], parts[3])
