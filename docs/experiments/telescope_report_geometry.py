"""The geometry that the report does not print, inferred from the bias of its parameters (Table 6a minus 7a).

Both fits had the same measurements, so their noise cancels to first order. Their difference is the effect of K's
off-diagonal part, by the observability Jacobian of each leg at the 40 configurations. K and the configurations are in
print; what is left unknown is the shape: two radii, two half separations, and which legs stand next to each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from docs.experiments.telescope_report_absorption import calibrate, ignorant, leg_fits, shift_by_K
from docs.experiments.telescope_report_data import LENGTHS, published
from docs.experiments.telescope_report_machine import OpenError, Pattern, Shape, machine, stand
from truing.estimation.least_squares.solver import SolverStatus, least_squares
from truing.simulation.mechanisms.parameters import report_set
from truing.simulation.mechanisms.structures.structure import Machine

START = np.array([0.15, 0.13, np.radians(10.0), np.radians(10.0)])
EXTRA = {"turned": 0.0, "twist": 0.0, "leg length": 0.5}
# Fourth-order differences: with 0.2 mm and 0.2 mrad their error is 1e-11 of the slope.
_STEP, _STENCIL = 2e-4, np.array([[-2, -1, 1, 2], [1 / 12, -2 / 3, 2 / 3, -1 / 12]])
_ROWS_OF_A_FIT = [0, 1, 2, 3, 5]  # a_x a_y b_x b_y l; kappa is kept for a check
# A table's last digit is 0.01 mm, and two of them make a difference.
ROUNDING_MM = 0.01 * np.sqrt(2 / 12)


@dataclass(frozen=True)
class ShapeFit:
    """A shape inferred from the tables: numbers in m and rad, with the covariance that the misfit speaks of."""

    names: tuple[str, ...]
    numbers: NDArray
    covariance: NDArray
    residual: NDArray  # (5, 6) mm, predicted minus observed, NaN where a leg was left out
    status: str
    pattern: Pattern = field(default_factory=Pattern)

    @property
    def sigma(self) -> NDArray:
        """Return the standard deviations of the numbers."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def rms(self) -> float:
        """Return the rms misfit, mm."""
        return float(np.sqrt(np.nanmean(self.residual**2)))

    @property
    def correlation(self) -> float:
        """Return the correlation of predicted and observed shifts."""
        used = np.isfinite(self.residual)
        return float(np.corrcoef((observed() + self.residual)[used], observed()[used])[0, 1])

    @property
    def machine(self) -> Machine:
        """Return the machine of this shape."""
        return machine_of(self.names, self.numbers, self.pattern)


FOUR = ("base radius", "platform radius", "base half separation", "platform half separation")


def observed() -> NDArray:
    """Return Table 6a less 7a, (5, 6) mm."""
    moved = published().moved("6a")
    return np.array([moved[name] for name in LENGTHS])


def machine_of(names: tuple[str, ...], numbers: NDArray, pattern: Pattern) -> Machine:
    """Return the machines of numbers (..., P), which beyond the four may name a turn, a twist, a leg length."""
    more = {name: numbers[..., i] for i, name in enumerate(names)}
    base, platform, base_half, platform_half = (more[name] for name in FOUR)
    turned, twist = more.get("turned", 0.0), more.get("twist", 0.0)
    shape = Shape(base, platform, base_half, platform_half, turned, twist)
    return machine(shape, pattern, more.get("leg length"))


def predicted(names: tuple[str, ...], numbers: NDArray, pattern: Pattern) -> NDArray:
    """Return Table 6a less 7a (..., 5, 6), mm, of machines with numbers (..., P)."""
    return 1e3 * leg_fits(machine_of(names, numbers, pattern), "6a").shift[..., _ROWS_OF_A_FIT, :]


def fit_shape(
    pattern: Pattern | None = None,
    extra: tuple[str, ...] = (),
    without: int | None = None,
    whitened: NDArray | None = None,
    max_iterations: int = 60,
) -> ShapeFit:
    """Return the shape that fits Table 6a less 7a best; every entry weighs the same, or by `whitening` (6, W, 5).

    extra: of EXTRA, to be fitted too; without: a leg, from 0, that is left out.
    """
    pattern, names = pattern or Pattern(), (*FOUR, *extra)
    weight = np.broadcast_to(np.eye(5), (6, 5, 5)) if whitened is None else whitened
    weight = np.where(np.arange(6)[:, None, None] == (-1 if without is None else without), 0.0, weight)

    def misfit(x: NDArray) -> tuple[NDArray, NDArray]:
        off, slope = _misfit_and_slope(names, x, pattern)
        value = np.einsum("iws,bsi->biw", weight, off).reshape(len(x), -1)
        return value, np.einsum("iws,bsip->biwp", weight, slope).reshape(*value.shape, -1)

    found = least_squares(misfit, np.append(START, [EXTRA[name] for name in extra]), max_iterations=max_iterations)
    freedom = (30 if without is None else 25) - len(names)
    scale = found.cost[0] / freedom if whitened is None else 1.0
    residual = predicted(names, found.x[0], pattern) - observed()
    if without is not None:
        residual[:, without] = np.nan
    return ShapeFit(names, found.x[0], scale * found.covariance[0], residual, str(found.status[0]), pattern)


def _misfit_and_slope(names: tuple[str, ...], x: NDArray, pattern: Pattern) -> tuple[NDArray, NDArray]:
    """Return predicted minus observed (B, 5, 6) and its derivative (B, 5, 6, P), mm; NaN where no such machine stands.

    Half separations end at 30 degrees, beyond which the other pairs are the close ones.
    """
    size = x.shape[1]
    steps = _STEP * _STENCIL[0][:, None, None] * np.eye(size)
    try:
        if np.any((x[:, 2:4] < 0.0) | (x[:, 2:4] > np.radians(30.0))):
            raise OpenError
        around = predicted(names, x[:, None, None] + np.concatenate([steps, np.zeros((1, size, size))]), pattern)
    except (OpenError, np.linalg.LinAlgError):
        around = np.full((len(x), 5, size, 5, 6), np.nan)
    slope = np.einsum("k,bkprl->brlp", _STENCIL[1] / _STEP, around[:, :4])
    return around[:, 4, 0] - observed(), slope


@cache
def best_shape() -> ShapeFit:
    """Return the shape that this page uses; raises ArithmeticError where the fit did not converge."""
    found = fit_shape()
    if found.status != SolverStatus.CONVERGED:
        raise ArithmeticError(f"shape: found {found.status}, expected a converged fit")
    return found


@cache
def shape_without(leg: int) -> ShapeFit:
    """Return the shape that the legs other than one ask for."""
    return fit_shape(without=leg)


def held_out() -> NDArray:
    """Return the predictions (5, 6), mm, of each leg's entries by the shape fitted to the other five legs."""
    fits = [shape_without(leg) for leg in range(6)]
    columns = [predicted(fit.names, fit.numbers, fit.pattern)[:, leg] for leg, fit in enumerate(fits)]
    return np.stack(columns, -1)


def jackknife() -> NDArray:
    """Return the standard deviations (4,) of the shape's numbers from leaving out one leg at a time."""
    numbers = np.array([shape_without(leg).numbers for leg in range(6)])
    return np.sqrt(5 / 6 * np.sum((numbers - numbers.mean(0)) ** 2, 0))


def rival_patterns() -> list[Pattern]:
    """Return all other numberings: pairs, sense of turning, and orientation in steps of 30 degrees."""
    chosen = Pattern()
    patterns = [
        Pattern(platform, turning, np.radians(30.0 * k))
        for platform in (True, False)
        for turning in (1, -1)
        for k in range(-6, 6)
    ]
    return [p for p in patterns if (p.platform, p.turning) != (True, 1) or abs(p.towards - chosen.towards) > 0.01]


def rivals() -> list[ShapeFit]:
    """Return the fits of all other numberings, best first; few end at a minimum, most at a ring that degenerates."""
    return sorted((fit_shape(pattern, max_iterations=20) for pattern in rival_patterns()), key=lambda fit: fit.rms)


def scatter_by_K(sigma: float, of: Machine | None = None) -> NDArray:
    """Return the covariance (6 legs, 5, 5), mm^2, of Table 6a less 7a where off-diagonal K has errors of a sigma."""
    by_K = 1e3 * shift_by_K(of or best_shape().machine, "6a")[:, _ROWS_OF_A_FIT]
    by_K[np.arange(6), :, np.arange(6)] = 0.0
    return sigma**2 * by_K @ np.swapaxes(by_K, -1, -2) + ROUNDING_MM**2 * np.eye(5)


def whitening(sigma: float) -> NDArray:
    """Return the matrices (6 legs, 4, 5) that whiten the four directions of a leg's five entries that K affects.

    The fifth is the leg's length at rest, which no deformation changes; it varies by the tables' rounding alone.
    """
    variance, direction = np.linalg.eigh(scatter_by_K(sigma))
    return np.swapaxes(direction[..., 1:], -1, -2) / np.sqrt(variance[:, 1:, None])


def chi_square(sigma: float) -> float:
    """Return the misfit of the best shape where K is known to sigma; 20 (24 directions, 4 numbers) if that is so."""
    return float(np.sum(np.einsum("iwr,ri->iw", whitening(sigma), best_shape().residual) ** 2))


@cache
def sigma_of_K() -> float:
    """Return the error of K's entries, one sigma, that makes the misfit what it is."""
    from scipy.optimize import brentq

    return float(np.exp(brentq(lambda log: chi_square(np.exp(log)) - 20.0, np.log(1e-4), np.log(1e-2))))


def weighted_shape() -> ShapeFit:
    """Return the shape where every entry counts as K's error lets it, with the covariance that follows."""
    return fit_shape(whitened=whitening(sigma_of_K()))


def best_single_entry() -> tuple[str, float]:
    """Return the off-diagonal entry of K whose change would take most off the misfit, and the share that it takes."""
    slope, left = shift_by_K(best_shape().machine, "6a")[:, _ROWS_OF_A_FIT], best_shape().residual.T
    gain = np.einsum("irj,ir->ij", slope, left) ** 2 / np.sum(slope**2, 1)
    np.fill_diagonal(gain, 0.0)
    i, j = np.unravel_index(np.argmax(gain), gain.shape)
    return f"K{i + 1}{j + 1}", float(gain.max() / np.sum(left**2))


def misfit_of_the_real_machine() -> float:
    """Return the rms misfit, mm, where the true machine is that of Table 7a and all fits are nonlinear."""
    design, tables = best_shape().machine, published()
    parameters = report_set(design, "matrix")
    names = dict.fromkeys(entry.name for entry in parameters.entries)
    off = np.concatenate([tables.tables["7a"][name] for name in names])
    true = parameters.machine(design, parameters.values(design) + off * parameters.units)
    found = calibrate(ignorant(design, "6a"), report_set(design, "linear"), stand(true)).rows
    return float(np.sqrt(np.mean([(found[name] - tables.tables["6a"][name]) ** 2 for name in LENGTHS])))
