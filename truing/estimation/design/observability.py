"""What a set of measurements can tell about parameters, before any of them is taken.

Columns of the Jacobian are counted in tolerances and its rows in standard deviations of the noise. A singular value is
then a signal-to-noise ratio: how many sigma the data move when the parameters move by one tolerance along a direction,
and its inverse is the standard deviation that the data alone leave there, in tolerances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Where the data alone know a direction no better than this many tolerances, they tell less than the drawing does.
UNIDENTIFIABLE = 1.0


@dataclass(frozen=True)
class Observability:
    """Singular values and directions of a scaled observability Jacobian of N rows and P parameters.

    labels, scales (P,): name and tolerance of each parameter. triangle (P, P): factor of the scaled Jacobian, which has
    its singular values and directions. singular_values (P,): descending. directions (P, P): a column for each, in
    tolerances. least: singular value up to which a direction counts as unidentifiable. rounding: the value that the
    computer's arithmetic alone may leave of a zero.
    """

    labels: tuple[str, ...]
    scales: NDArray
    triangle: NDArray
    singular_values: NDArray
    directions: NDArray
    least: float
    rounding: float

    @property
    def rank(self) -> int:
        """Return how many directions are identifiable."""
        return int(np.sum(self.singular_values > self.least))

    @property
    def condition(self) -> float:
        """Return the condition number, infinite where a direction is null to rounding."""
        if not len(self.singular_values):  # no parameter at all
            return np.inf
        first, last = self.singular_values[0], self.singular_values[-1]
        return float(first / last) if last > self.rounding else np.inf

    @property
    def unseen(self) -> NDArray:
        """Return the unidentifiable directions (P, P - rank), orthonormal, in tolerances."""
        return self.directions[:, self.rank :]

    @cached_property
    def sigma(self) -> NDArray:
        """Return the standard deviation (P,) that the data alone give, infinite where rounding hides a direction."""
        known = self.singular_values > self.rounding
        if not known.any():
            return np.full(len(self.scales), np.inf)
        scatter = self.directions[:, known] / self.singular_values[known]
        # A null direction is itself turned by rounding, at most so much, towards the seen ones (Davis and Kahan).
        turned = self.rounding / self.singular_values[known].min()
        hidden = np.any(np.abs(self.directions[:, ~known]) > turned, axis=1)
        return np.where(hidden, np.inf, self.scales * np.linalg.norm(scatter, axis=1))

    @cached_property
    def sigma_with_prior(self) -> NDArray:
        """Return the standard deviation (P,) that the data and the tolerances give together."""
        scatter = self.directions / np.hypot(self.singular_values, 1.0)
        return np.asarray(self.scales * np.linalg.norm(scatter, axis=1))

    @property
    def identifiable(self) -> NDArray:
        """Return which parameters (P,) the data alone determine, all others being free."""
        return self.sigma * self.least < self.scales

    def sensitivity(self, change: NDArray) -> NDArray:
        """Return by how many sigma, for one tolerance along them, changes (P, ...) in tolerances are seen (...)."""
        return np.asarray(np.linalg.norm(self.triangle @ change, axis=0) / np.linalg.norm(change, axis=0))


def observe(
    jacobian: NDArray,
    scales: ArrayLike,
    labels: Sequence[str],
    *,
    unidentifiable: float = UNIDENTIFIABLE,
    accuracy: float = np.finfo(float).eps,
) -> Observability:
    """Return what data with a whitened Jacobian (N, P) tell about P parameters of given tolerances (P,).

    A direction is unidentifiable where the data alone leave it ``unidentifiable`` tolerances or more uncertain: at 1
    the data halve the variance that the tolerances left, below they hardly touch it. Arithmetic bounds what can be
    told at all: entries of relative ``accuracy`` move no singular value by more than ``accuracy`` max(N, P) times the
    largest (Weyl), and what lies below that counts as zero. Both thresholds are invariant to units, to the order of
    rows and parameters and to rotations among the rows; rows that were not whitened make the first one meaningless.
    Raises ValueError for shapes that do not match, values that are not finite or scales that are not positive.
    """
    J, tolerance = np.asarray(jacobian, float), np.asarray(scales, float)
    if J.ndim != 2 or tolerance.shape != J.shape[1:] or len(labels) != J.shape[-1]:
        raise ValueError(f"found jacobian {J.shape}, scales {tolerance.shape}, {len(labels)} labels, expected (N, P)")
    if not np.isfinite(J).all() or not np.all(np.isfinite(tolerance) & (tolerance > 0)):
        raise ValueError("jacobian and scales have to be finite, and scales positive")
    triangle = _triangle(J * tolerance)
    _, values, rows = np.linalg.svd(triangle)
    rounding = accuracy * max(J.shape) * float(values.max(initial=0.0))
    least = max(1.0 / unidentifiable, rounding)
    return Observability(tuple(labels), tolerance, triangle, values, rows.T, least, rounding)


def _triangle(scaled: NDArray) -> NDArray:
    """Return the triangular factor (P, P), rows of zeros where there are fewer measurements than parameters."""
    factor = np.linalg.qr(scaled, mode="r")
    return np.concatenate([factor, np.zeros((scaled.shape[1] - len(factor), scaled.shape[1]))])


@dataclass(frozen=True)
class Indices:
    """Observability indices of the calibration literature, from m singular values and a number n of poses.

    o1: (s_1 ... s_m)^(1/m) / sqrt(n), Borm and Menq, Int. J. Robotics Research 10 (1991) 51 (D-optimality).
    o2: s_m / s_1, Driels and Pathre, J. Robotic Systems 7 (1990) 155.
    o3: s_m, Nahvi, Hollerbach and Hayward, IEEE ICRA (1994) 985 (E-optimality).
    o4: s_m^2 / s_1, the noise amplification index, Nahvi and Hollerbach, IEEE ICRA (1996) 647.
    o5: 1 / (1/s_1 + ... + 1/s_m), Sun and Hollerbach, IEEE ICRA (2008) 831 (related to A-optimality).
    log_determinant: log det J'J, which orders sets of as many poses as o1 does; the telescope report's O1, section 6.3.
    """

    o1: float
    o2: float
    o3: float
    o4: float
    o5: float
    log_determinant: float


def indices(singular_values: NDArray, poses: int) -> Indices:
    """Return the indices of m singular values (m,), descending, measured in a number of poses; zero where one is zero.

    All but the order by o1 and the log determinant change with the units of parameters that are not counted in
    tolerances. They are meant for an identifiable set: one unidentifiable direction rules all of them.
    """
    s = np.asarray(singular_values, float)
    if not len(s) or s[-1] <= 0:
        return Indices(0.0, 0.0, 0.0, 0.0, 0.0, -np.inf)
    logs = np.log(s)
    o1 = np.exp(logs.mean()) / np.sqrt(poses)
    figures = (o1, s[-1] / s[0], s[-1], s[-1] ** 2 / s[0], 1.0 / np.sum(1.0 / s), 2.0 * logs.sum())
    return Indices(*map(float, figures))
