"""From channels measured one at a time to the displacement of the platform in six components, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_RELATIVE = 1e-10  # eigenvalue of the information, its diagonal scaled to one, below which a direction is unknown


@dataclass(frozen=True)
class PlatformDisplacement:
    """Displacements of K load cases: dx, dy, dz in m and the rotation vector in rad.

    value (K, 6) NaN where unknown; covariance (K, 6, 6), infinite on the diagonal where unknown and zero beside it;
    known (K, 6). gain (K, 6, Z) and zero_covariance (Z, Z): how the errors of the zeros, which cases share, move them.
    chi_square and dof of readings that say the same thing twice.
    """

    value: Array
    covariance: Array
    known: Mask
    gain: Array
    zero_covariance: Array
    chi_square: float
    dof: int

    def between(self, first: int, second: int) -> Array:
        """Covariance (6, 6) of two different cases: that of the zeros which both count from; zero where unknown."""
        return self.gain[first] @ self.zero_covariance @ self.gain[second].T


def platform_displacement(
    rows: Array,
    reading: ArrayLike,
    sigma: ArrayLike,
    case: NDArray[np.int64],
    zero: NDArray[np.int64],
    zero_sigma: ArrayLike,
) -> PlatformDisplacement:
    """Join readings (N,) with noise sigma (N,) to displacements of the cases 0 .. K-1 that they belong to (N,).

    rows (N, 6): how a reading follows the displacement (``readings.linear_rows``, ``angular_rows``); zero (N,): the
    number 0 .. Z-1 of the zero that it counts from, which is itself read with zero_sigma (Z,) or one number. What the
    channels of a case do not determine stays unknown; nothing is taken from other cases. NaN readings take no part.
    """
    rows, y = np.asarray(rows, float), np.asarray(reading, float)
    if rows.shape != (len(y), 6) or len(case) != len(y) or len(zero) != len(y):
        raise ValueError(
            f"rows {rows.shape}, reading {y.shape}, case {case.shape} and zero {zero.shape}: expected (N, 6) and N"
        )
    seen = np.isfinite(y)
    cases, zeros = int(case.max(initial=-1)) + 1, int(zero.max(initial=-1)) + 1
    weight = np.where(seen, 1.0 / np.broadcast_to(np.asarray(sigma, float), y.shape), 0.0)
    white, measured = rows * weight[:, None], weight * np.where(seen, y, 0.0)
    information, coupling = np.zeros((cases, 6, 6)), np.zeros((cases, 6, zeros))
    right, of_zero, zero_right = np.zeros((cases, 6)), np.zeros(zeros), np.zeros(zeros)
    np.add.at(information, case, white[:, :, None] * white[:, None, :])
    np.add.at(coupling, (case[:, None], np.arange(6), zero[:, None]), white * weight[:, None])
    np.add.at(right, case, white * measured[:, None])
    np.add.at(of_zero, zero, weight**2)
    np.add.at(zero_right, zero, weight * measured)
    inverse, known, rank = _inverse_where_known(information)
    # the zeros are eliminated last: what they are known by beside their own reading is left of all the cases
    held = inverse @ coupling
    prior = np.broadcast_to(np.asarray(zero_sigma, float), (zeros,)) ** -2.0
    zero_information = np.diag(of_zero + prior) - np.einsum("kiz,kiy->zy", coupling, held)
    zero_covariance = np.linalg.inv(zero_information)
    offset = zero_covariance @ (zero_right - np.einsum("kiz,ki->z", held, right))
    value = np.einsum("kij,kj->ki", inverse, right) - held @ offset
    covariance = inverse + held @ zero_covariance @ np.swapaxes(held, 1, 2)
    left = measured - np.einsum("ni,ni->n", white, value[case]) - weight * offset[zero]
    both = known[:, :, None] & known[:, None, :]
    covariance = np.where(both, covariance, np.where(np.eye(6, dtype=bool), np.inf, 0.0))
    return PlatformDisplacement(
        np.where(known, value, np.nan),
        covariance,
        known,
        np.where(known[..., None], held, 0.0),
        zero_covariance,
        float(left @ left + np.sum(prior * offset**2)),
        int(seen.sum() - rank.sum()),
    )


def _inverse_where_known(information: Array) -> tuple[Array, Mask, NDArray[np.int64]]:
    """Pseudo-inverses (K, 6, 6), which components (K, 6) lie wholly in what is known, and its rank (K,)."""
    size = np.sqrt(np.einsum("kii->ki", information))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(information / (scale[:, :, None] * scale[:, None, :]))
    kept = values > _RELATIVE
    inverse = np.einsum("kie,ke,kje->kij", vectors, kept / np.where(kept, values, 1.0), vectors)
    lost = np.einsum("kie,ke->ki", vectors**2, ~kept)
    known = (lost < _RELATIVE) & (size > 0.0)
    return inverse / (scale[:, :, None] * scale[:, None, :]), known, kept.sum(1)
