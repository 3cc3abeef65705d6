"""Random point sets and motions for the tests of estimation."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from truing.estimation.rotation import log_so3

seeds = st.integers(0, 2**32 - 1)
vectors = arrays(np.float64, (3,), elements=st.floats(-1.0, 1.0))


def random_rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return rotations (count, 3, 3), uniform over the group (QR of Gaussian matrices)."""
    Q, T = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    Q = Q * np.sign(np.diagonal(T, axis1=1, axis2=2))[:, None]
    return Q * np.sign(np.linalg.det(Q))[:, None, None]


def random_motions(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return R (count, 3, 3) and t (count, 3) in m, of the size of a room."""
    return random_rotations(rng, count), rng.uniform(-3.0, 3.0, (count, 3))


def body(rng: np.random.Generator, points: int, size: float = 0.3) -> np.ndarray:
    """Return the survey (points, 3), in m, of a body that is not quite centred on its origin."""
    return size * (rng.uniform(-0.5, 0.5, (points, 3)) + 0.2)


def move(R: np.ndarray, t: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points (N, 3) or (B, N, 3) moved by R (B, 3, 3), t (B, 3)."""
    return points @ np.swapaxes(R, -1, -2) + t[:, None]


def pose_error(R: np.ndarray, t: np.ndarray, R_true: np.ndarray, t_true: np.ndarray) -> np.ndarray:
    """Return the errors (B, 6) in the order of the covariance: (t - t_true, log(R R_true^T))."""
    return np.concatenate([t - t_true, log_so3(R @ np.swapaxes(R_true, -1, -2))], axis=-1)


def squared_pulls(error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the squared Mahalanobis lengths (B,) of errors (B, 6)."""
    return np.einsum("bi,bi->b", error, np.linalg.solve(covariance, error[..., None])[..., 0])
