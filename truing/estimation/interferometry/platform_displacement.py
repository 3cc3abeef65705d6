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
    known (K, 6). shared (Z,) and shared_covariance (Z, Z): the errors that cases share, as found; gain (K, 6, Z): how
    they move a case.
    chi_square and dof of readings that say the same thing twice.
    """

    value: Array
    covariance: Array
    known: Mask
    shared: Array
    shared_covariance: Array
    gain: Array
    chi_square: float
    dof: int

    def between(self, first: int, second: int) -> Array:
        """Covariance (6, 6) of two different cases: that of the errors which both share; zero where unknown."""
        return self.gain[first] @ self.shared_covariance @ self.gain[second].T


def zero_columns(run: NDArray[np.int64]) -> Array:
    """Return columns (N, G) of the zeros that readings of runs 0 .. G-1 count from."""
    return (np.asarray(run)[:, None] == np.arange(int(np.max(run, initial=-1)) + 1)).astype(float)


def drift_columns(run: NDArray[np.int64], time_s: ArrayLike) -> Array:
    """Return columns (N, G) of the drifts of runs 0 .. G-1, per second since the first reading of each."""
    member = zero_columns(run)
    time = np.asarray(time_s, float)
    begin = np.min(np.where(member > 0.0, time[:, None], np.inf), axis=0, initial=np.inf)
    return member * (time[:, None] - np.where(np.isfinite(begin), begin, 0.0))


def platform_displacement(
    rows: Array,
    reading: ArrayLike,
    sigma: ArrayLike,
    case: NDArray[np.int64],
    shared: Array,
    shared_sigma: ArrayLike,
) -> PlatformDisplacement:
    """Join readings (N,) with noise sigma (N,) to displacements of the cases 0 .. K-1 that they belong to (N,).

    rows (N, 6): how a reading follows the displacement (``readings.linear_rows``, ``angular_rows``); shared (N, Z): the
    errors that readings of several cases have in common (``zero_columns``, ``drift_columns``), with the standard
    deviations shared_sigma (Z,) that are known of them, infinite where nothing is. What the channels of a case do
    not determine stays unknown; nothing is taken from other cases. NaN readings take no part. Raises ValueError for
    shapes that do not agree, and for shared errors of which neither readings nor their sigma say anything.
    """
    rows, y, shared = np.asarray(rows, float), np.asarray(reading, float), np.asarray(shared, float)
    if rows.shape != (len(y), 6) or len(case) != len(y) or shared.ndim != 2 or len(shared) != len(y):
        raise ValueError(
            f"rows {rows.shape}, case {case.shape} and shared {shared.shape} of {len(y)} readings: "
            f"expected (N, 6), (N,) and (N, Z)"
        )
    seen = np.isfinite(y)
    cases = int(case.max(initial=-1)) + 1
    weight = np.where(seen, 1.0 / np.broadcast_to(np.asarray(sigma, float), y.shape), 0.0)
    white, measured, common = rows * weight[:, None], weight * np.where(seen, y, 0.0), shared * weight[:, None]
    information, coupling = np.zeros((cases, 6, 6)), np.zeros((cases, 6, shared.shape[1]))
    right = np.zeros((cases, 6))
    np.add.at(information, case, white[:, :, None] * white[:, None, :])
    np.add.at(coupling, case, white[:, :, None] * common[:, None, :])
    np.add.at(right, case, white * measured[:, None])
    inverse, known, rank = _inverse_where_known(information)
    # the shared errors are eliminated last: what tells of them is what the cases leave over, and what is known before
    held = inverse @ coupling
    prior = np.broadcast_to(np.asarray(shared_sigma, float), shared.shape[1:]) ** -2.0
    told = common.T @ common + np.diag(prior) - np.einsum("kiz,kiy->zy", coupling, held)
    shared_covariance = _inverse_of_shared(told)
    offset = shared_covariance @ (common.T @ measured - np.einsum("kiz,ki->z", held, right))
    value = np.einsum("kij,kj->ki", inverse, right) - held @ offset
    covariance = inverse + held @ shared_covariance @ np.swapaxes(held, 1, 2)
    left = measured - np.einsum("ni,ni->n", white, value[case]) - common @ offset
    both = known[:, :, None] & known[:, None, :]
    covariance = np.where(both, covariance, np.where(np.eye(6, dtype=bool), np.inf, 0.0))
    return PlatformDisplacement(
        np.where(known, value, np.nan),
        covariance,
        known,
        offset,
        shared_covariance,
        np.where(known[..., None], held, 0.0),
        float(left @ left + np.sum(prior * offset**2)),
        int(seen.sum() - rank.sum() - np.sum(prior == 0.0)),
    )


def _inverse_of_shared(told: Array) -> Array:
    """Inverse (Z, Z) of the information on the shared errors."""
    scale = np.sqrt(np.where(np.diag(told) > 0.0, np.diag(told), 1.0))
    scaled = told / np.outer(scale, scale)
    if len(told) and np.linalg.eigvalsh(scaled)[0] < _RELATIVE:
        raise ValueError("shared errors: found some that no reading tells of, expected a finite shared_sigma for them")
    return np.linalg.inv(scaled) / np.outer(scale, scale)


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
