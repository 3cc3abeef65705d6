"""What the tables' kappa and u_x say of each other, of the legs, and of how Tables 7a and 7c are to be read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docs.experiments.telescope_report_absorption import leg_fits, shift_by_K
from docs.experiments.telescope_report_data import published
from docs.experiments.telescope_report_geometry import ROUNDING_MM, best_shape, sigma_of_K
from docs.experiments.telescope_report_remainder import ROWS, remainder


@dataclass(frozen=True)
class Relations:
    """Checks that the fit of the shape does not use, leg by leg (6,)."""

    slope: NDArray  # z_x / z_z from u_x of Table 5a and kappa of 6a
    slope_sigma: NDArray  # by the rounding of u_x to 0.01
    slope_of_shape: NDArray
    u_x: NDArray  # from kappa and the slope of the shape
    rho0: NDArray  # mm, -(a_x of 5a less a_x of 6a) / u_x
    rho0_sigma: NDArray


def relations() -> Relations:
    """Return what joins Tables 5a and 6a: kappa = u_x^2/2 - u_x z_x/z_z, and a_x moves by -rho0 u_x (eq. 40)."""
    u, kappa = published().tables["5a"]["u_x"], published().kappa("6a")
    legs = best_shape().machine.legs
    height = np.sqrt(legs.l**2 - np.sum((legs.b - legs.a)[:, :2] ** 2, -1))
    shape_slope = (legs.b - legs.a)[:, 0] / height
    moved = published().tables["5a"]["a_x"] - published().tables["6a"]["a_x"]
    rounding = 0.01 / np.sqrt(12)
    return Relations(
        slope=u / 2 - kappa / u,
        slope_sigma=rounding * np.abs(0.5 + kappa / u**2),
        slope_of_shape=shape_slope,
        u_x=shape_slope - np.sign(shape_slope) * np.sqrt(shape_slope**2 + 2 * kappa),
        rho0=-moved / u,
        rho0_sigma=np.hypot(ROUNDING_MM / u, rounding * moved / u**2),
    )


def reference_reading() -> tuple[float, float]:
    """Return rho0, mm, pooled over the legs, and its standard deviation."""
    found = relations()
    weight = 1 / found.rho0_sigma**2
    return float(np.sum(weight * found.rho0) / weight.sum()), float(weight.sum() ** -0.5)


@dataclass(frozen=True)
class Reading:
    """How well Tables 6a and 7a agree about kappa where Table 7 is read as counted from a nominal value."""

    observed: NDArray  # (6,) 1e-3, kappa of 6a less kappa of 7a
    predicted: NDArray
    sigma: NDArray
    chi_square: float
    p: float


def kappa_reading(nominal: NDArray | float) -> Reading:
    """Return how far 6a less 7a is from K's absorption where Table 7 counts kappa from a nominal value (6,)."""
    from scipy.stats import chi2

    tables = published()
    fits = leg_fits(best_shape().machine, "6a")
    seen = 1e3 * (tables.kappa("6a") - nominal - tables.tables["7a"]["kappa"])
    # beside the diagonal, which 7a fits as 6a does
    by_K = 1e3 * shift_by_K(best_shape().machine, "6a")[:, ROWS.index("kappa")]
    by_K[np.arange(6), np.arange(6)] = 0.0
    # 7a's own kappa started from K_ii, so that the shift is the off-diagonal part's
    predicted, sigma = 1e3 * fits.shift[ROWS.index("kappa")], sigma_of_K() * np.linalg.norm(by_K, axis=1)
    total = float(np.sum(((seen - predicted) / sigma) ** 2))
    return Reading(seen, predicted, sigma, total, float(chi2.sf(total, 6)))


@dataclass(frozen=True)
class HeldKappa:
    """Table 7c less 7a, and what holding kappa at 7c's values would make of a fit that otherwise is 7a's."""

    observed: NDArray  # (5 rows, 6 legs) mm
    predicted: NDArray

    @property
    def correlation(self) -> float:
        """Return the correlation over all entries."""
        return float(np.corrcoef(self.observed.ravel(), self.predicted.ravel())[0, 1])


def held_kappa() -> HeldKappa:
    """Return the reading of Table 7c as a fit whose kappa hardly moved."""
    jacobian = leg_fits(best_shape().machine, "6a").jacobian
    free = [k for k, name in enumerate(ROWS) if name != "kappa"]
    difference = remainder("7c") - remainder("7a")
    by_kappa = jacobian[..., ROWS.index("kappa")] * difference[ROWS.index("kappa"), :, None]
    answer = -np.einsum("irn,in->ri", np.linalg.pinv(jacobian[..., free]), by_kappa)
    return HeldKappa(difference[free], answer)
