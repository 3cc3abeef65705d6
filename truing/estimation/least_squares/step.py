"""The linear problem at a point of a non-linear least-squares fit, and how far along its solution one may go.

Everything comes from the singular values of the Jacobian with its columns scaled, found by QR and then SVD: nothing is
squared, so no digits are lost where parameters are nearly dependent. B problems at once, independent of each other.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

EPS = float(np.finfo(float).eps)
# A linear model is trusted further above the one, less below the other (Moré 1978).
_GOOD, _POOR = 0.75, 0.25
# What rounding leaves of a singular value that is zero.
_ROUNDED = 10.0 * EPS
# Square of the share of a parameter in an undetermined direction from which on it is not determined itself.
_TAKES_PART = 1e-10
_FIRST_DAMPING = 1e-3
_SECULAR_STEPS = 12


@dataclass
class Linear:
    """``residual + jacobian step`` in scaled parameters: singular values, their directions, the residual along them."""

    scale: NDArray  # (B, P) largest norm so far of each column of the Jacobian
    column: NDArray  # (B, P) norm of each column here
    singular: NDArray  # (B, K) singular values of the scaled Jacobian, zero where it is deficient
    direction: NDArray  # (B, K, P) orthonormal rows, scaled parameters
    along: NDArray  # (B, K) components of the residual that the parameters can change

    @property
    def offset(self) -> NDArray:
        """Return the norm (B,) of what a linear problem would remove of the residual."""
        return np.sqrt(np.sum(np.where(self.singular > 0.0, self.along, 0.0) ** 2, -1))

    @property
    def rank(self) -> NDArray:
        """Return how many directions (B,) the residuals determine."""
        return np.sum(self.singular > 0.0, -1)

    def __getitem__(self, rows: NDArray) -> Linear:
        """Return some of the problems."""
        return Linear(*(getattr(self, field.name)[rows] for field in fields(self)))

    def put(self, rows: NDArray, other: Linear) -> None:
        """Exchange some of the problems."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(other, field.name)

    def step(self, damping: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return the step (B, P), its length (B,) in scaled parameters, and the decrease (B,) that it promises.

        damping (B,) is added to the squares of the singular values; the decrease is that of the sum of squares.
        """
        square = self.singular**2 + damping[:, None]
        part = _ratio(self.singular * self.along, np.where(self.singular > 0.0, square, 0.0))
        left = _ratio(damping[:, None] * np.ones_like(square), square)
        step = -np.einsum("bk,bkp->bp", part, self.direction) / self.scale
        promised = np.sum(np.where(self.singular > 0.0, self.along**2 * (1.0 - left**2), 0.0), -1)
        return step, np.sqrt(np.sum(part**2, -1)), promised

    def covariance(self) -> NDArray:
        """Return the inverse of J^T J (B, P, P), NaN where an undetermined direction takes part."""
        inverse = _ratio(np.ones_like(self.singular), self.singular)
        root = inverse[..., None] * self.direction / self.scale[:, None, :]
        touched = np.sum(np.where(self.singular[..., None] > 0.0, self.direction**2, 0.0), 1) < 1.0 - _TAKES_PART
        blank = np.where(touched, np.nan, 0.0)
        return np.swapaxes(root, 1, 2) @ root + blank[:, :, None] + blank[:, None, :]


def linearise(
    residual: NDArray, jacobian: NDArray, scale: NDArray | float = 0.0, tolerance: float = _ROUNDED
) -> Linear:
    """Return the linear problem for residual (B, N) and jacobian (B, N, P), columns scaled by scale (B, P) or more.

    Singular values below ``tolerance`` of the largest count as zero.
    """
    column = np.sqrt(np.sum(jacobian**2, 1))
    scale = np.maximum(scale, column)
    scale = np.where(scale > 0.0, scale, 1.0)
    size = jacobian.shape[2]
    augmented = np.concatenate([jacobian / scale[:, None, :], residual[..., None]], -1)
    reduced = np.asarray(np.linalg.qr(augmented, mode="r"))
    left, singular, direction = np.linalg.svd(reduced[..., :size], full_matrices=False)
    along = np.einsum("bik,bi->bk", left, reduced[..., size])
    kept = np.where(singular > tolerance * singular[:, :1], singular, 0.0)
    return Linear(scale, column, kept, direction, along)


def _ratio(above: NDArray, below: NDArray) -> NDArray:
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0.0)


class Rule(Protocol):
    """How a method limits its steps; its memory is an array (B, 2)."""

    def start(self, linear: Linear, x: NDArray) -> NDArray:
        """Return the memory (B, 2) before the first step from x (B, P)."""

    def damping(self, linear: Linear, memory: NDArray) -> NDArray:
        """Return what is to be added to the squares of the singular values (B,)."""

    def learn(self, memory: NDArray, gain: NDArray, length: NDArray) -> NDArray:
        """Return the memory after a step of a length (B,) that brought ``gain`` (B,) of the promised decrease."""


class LevenbergMarquardt:
    """A damping per problem: ten times less after a step as promised, ever faster more after one that failed."""

    def start(self, linear: Linear, x: NDArray) -> NDArray:
        """Return the first damping, and the first factor of its growth."""
        return np.tile([_FIRST_DAMPING, 2.0], (len(x), 1))

    def damping(self, linear: Linear, memory: NDArray) -> NDArray:
        """Return the damping itself."""
        return memory[:, 0]

    def learn(self, memory: NDArray, gain: NDArray, length: NDArray) -> NDArray:
        """Nielsen (1999) for failures, Marquardt (1963) for successes."""
        damping, growth = memory.T
        changed = np.select([gain > _GOOD, gain > _POOR, gain > 0.0], [0.1, 0.5, 2.0], growth)
        return np.stack([damping * changed, np.where(gain > 0.0, 2.0, 2.0 * growth)], 1)


class TrustRegion:
    """A radius per problem in scaled parameters, and the exact minimum of the linear problem inside (Moré 1978)."""

    def start(self, linear: Linear, x: NDArray) -> NDArray:
        """Return a first radius that lets every parameter change by its own size, and the first damping."""
        size = np.sqrt(np.sum((linear.scale * x) ** 2, -1))
        return np.stack([np.where(size > 0.0, size, 1.0), np.zeros(len(x))], 1)

    def damping(self, linear: Linear, memory: NDArray) -> NDArray:
        """Return the damping that ends the step on the radius, zero where the free step ends inside."""
        radius, s, c = memory[:, 0], linear.singular, linear.along
        damping = np.zeros(len(radius))
        outside = linear.step(damping)[1] > 1.1 * radius
        for _ in range(_SECULAR_STEPS):
            square = s**2 + damping[:, None]
            part = _ratio(s * c, np.where(s > 0.0, square, 0.0))
            length = np.sqrt(np.sum(part**2, -1))
            slope = np.sum(_ratio(part**2, square), -1)
            more = _ratio(length**2 * (length / radius - 1.0), slope)  # Hebden's step, from below, never past the root
            damping = np.where(outside, np.maximum(damping + more, 0.0), 0.0)
        return damping

    def learn(self, memory: NDArray, gain: NDArray, length: NDArray) -> NDArray:
        """Return a quarter of the step after a poor one, twice the step after a good one."""
        radius = memory[:, 0]
        wider = np.where(gain > _GOOD, np.maximum(radius, 2.0 * length), radius)
        return np.stack([np.where(gain < _POOR, 0.25 * length, wider), memory[:, 1]], 1)


RULES: dict[str, Rule] = {"levenberg-marquardt": LevenbergMarquardt(), "trust-region": TrustRegion()}
