"""Absorption map: the bias of each fitted parameter by an effect that the model leaves out.

The effect changes the whitened residual by s, the parameters by the Jacobian N. The fit then shifts by -(N'N +
Lambda^-1)^-1 N's. The part of s in the column space disappears from the residual; only the rest is visible. This is
first order, with an error quadratic in the effect; `absorb_in_full` follows the curved model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.least_squares.solver import SolverStatus, least_squares

Against = Literal["fit", "truth", "nominal"]


@dataclass(frozen=True)
class Absorption:
    """Response of a fit of P parameters to Q effects outside its model, each of unit size.

    labels: of the parameters. shift (P, Q): change of the parameters, in their units. swallowed (P, Q): share of the
    effect's sum of squares that each absorbs (negative if parameters work against each other). left (N, Q): whitened
    residual after the fit. absorbed (Q,): share of the effect that disappears from the residual. visible (Q,): root of
    the increase of chi-square, which a test on the residual can detect. covariance (P, P): of the fit. prior (P, P):
    prior covariance of the parameters, None without.
    """

    labels: tuple[str, ...]
    shift: NDArray
    swallowed: NDArray
    left: NDArray
    absorbed: NDArray
    visible: NDArray
    covariance: NDArray
    prior: NDArray | None

    def comparison_covariance(self, effects: ArrayLike | None = None, against: Against = "truth") -> NDArray:
        """Return the covariance (P, P) of observed minus predicted shift, to first order.

        effects (Q, Q): covariance of the effects' sizes in the prediction; by default they are exact. The observed
        shift is the fit's distance from: ``fit``, a fit of the same data with the effect in its model (noise cancels,
        only the effects' sizes are uncertain); ``truth``, the true values (adds the fit's covariance); ``nominal``,
        the nominal values. This adds prior - covariance: true values scatter about nominal ones, and the fit follows
        as far as the data allow. Raises ValueError for nominal values without a prior.
        """
        if against == "nominal" and self.prior is None:
            raise ValueError("shifts from nominal values need their tolerances as prior")
        size = self.shift.shape[1]
        known = np.zeros((size, size)) if effects is None else np.asarray(effects, float).reshape(size, size)
        covariance = {"fit": 0.0, "truth": self.covariance, "nominal": -self.covariance}[against]
        return self.shift @ known @ self.shift.T + covariance + (self.prior if against == "nominal" else 0.0)


def absorb(jacobian: NDArray, signature: NDArray, labels: Sequence[str], scales: ArrayLike | None = None) -> Absorption:
    """Return the absorption of effects with signatures (N,) or (N, Q) by P parameters of a whitened Jacobian (N, P).

    Jacobian and signature are changes of the same whitened residual, by the parameters and by an effect of unit size.
    scales (P,): tolerances, if the fit uses them as prior; without, undetermined directions do not move, and the
    covariance leaves them out. Raises ValueError for shapes that do not match.
    """
    N = np.asarray(jacobian, float)
    effects = np.asarray(signature, float).reshape(len(N), -1)
    tolerance = None if scales is None else np.asarray(scales, float)
    root = _root(N, labels, tolerance)
    shift = -root @ (root.T @ (N.T @ effects))
    visible_effects = effects + N @ shift
    total_squares, visible_squares = np.sum(effects**2, axis=0), np.sum(visible_effects**2, axis=0)
    scale = np.where(total_squares > 0, total_squares, 1.0)
    pull = 0.0 if tolerance is None else np.sum((shift / tolerance[:, None]) ** 2, axis=0)
    return Absorption(
        tuple(labels),
        shift,
        swallowed=-shift * (N.T @ effects) / scale,
        left=visible_effects,
        absorbed=(total_squares - visible_squares) / scale,
        visible=np.sqrt(visible_squares + pull),
        covariance=root @ root.T,
        prior=None if tolerance is None else np.diag(tolerance**2),
    )


@dataclass(frozen=True)
class FullAbsorption:
    """Response of a non-linear fit of P parameters to an effect: shift (P,), residual left (N,), status."""

    shift: NDArray
    left: NDArray
    status: SolverStatus


def absorb_in_full(
    model: Callable[[NDArray], tuple[NDArray, NDArray]], signature: NDArray, scales: ArrayLike | None, size: int
) -> FullAbsorption:
    """Return the response of ``size`` parameters P to an effect of signature (N,), along the curved model.

    model(shift (P,)): change (N,) of the whitened residual, zero for no shift, and its derivative (N, P). scales (P,):
    tolerances as prior, None without.
    """
    weight = np.zeros((0, size)) if scales is None else np.diag(1.0 / np.asarray(scales, float))

    def residuals(x: NDArray) -> tuple[NDArray, NDArray]:
        changes, slopes = zip(*(model(shift) for shift in x), strict=True)
        value = np.concatenate([signature + np.stack(changes), x @ weight.T], axis=1)
        prior = np.broadcast_to(weight, (len(x), *weight.shape))
        return value, np.concatenate([np.stack(slopes), prior], axis=1)

    squares = least_squares(residuals, np.zeros(size))
    shift = squares.x[0]
    return FullAbsorption(shift, signature + model(shift)[0], SolverStatus(squares.status[0]))


def _root(N: NDArray, labels: Sequence[str], tolerance: NDArray | None) -> NDArray:
    """Return a root (P, r) of the fit's covariance after checking shapes."""
    if len(labels) != N.shape[1] or (tolerance is not None and tolerance.shape != N.shape[1:]):
        raise ValueError(f"found jacobian {N.shape}, {len(labels)} labels and scales {tolerance}, expected (N, P)")
    return _root_without_prior(N) if tolerance is None else _root_with_prior(N, tolerance)


def _root_with_prior(N: NDArray, tolerance: NDArray) -> NDArray:
    """Return G (P, P) with GG' = (N'N + Lambda^-1)^-1; one QR, since N'N would lose half of the digits."""
    factor = np.linalg.qr(np.concatenate([N * tolerance, np.eye(len(tolerance))]), mode="r")
    return tolerance[:, None] * np.linalg.inv(factor)


def _root_without_prior(N: NDArray) -> NDArray:
    """Return G (P, r) with GG' = (N'N)^-1 in the directions that are not null to rounding."""
    length = np.linalg.norm(N, axis=0)
    length = np.where(length > 0, length, 1.0)
    _, s, rows = np.linalg.svd(N / length, full_matrices=False)
    is_observed = s > np.finfo(float).eps * max(N.shape) * s[0]
    return rows[is_observed].T / s[is_observed] / length[:, None]
