"""A sensor's calibration: the matrix G_B and what belongs to it, by several estimators, in two directions.

``direct`` writes loads as terms of the signals, F = G_B V, as the force-sensor paper prints it (section 6.2);
``forward`` writes signals as terms of the loads, V = A F, which is what the sensor does, and inverts that. With as many
channels as loads and errors in both the two are the same; with more channels than loads only the second determines
anything in the directions that no load reaches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from truing.estimation.least_squares.solver import SolverStatus
from truing.estimation.sensor.terms import Powers, Terms

Estimator = Literal["least squares", "weighted", "errors in both"]
Direction = Literal["direct", "forward"]
Zero = Literal["none", "common", "case"]


@dataclass(frozen=True)
class CalibrationModel:
    """What is fitted, and how.

    zero: none, one for all rows, or one for every load case. ridge, shrink: prior standard deviation of what an input
    itself, and of what any other term contributes, as a share of the response's rms; None for no prior.
    """

    estimator: Estimator = "least squares"
    direction: Direction = "direct"
    zero: Zero = "none"
    drift: bool = False
    gain: bool = False
    powers: Powers = "linear"
    ridge: float | None = None
    shrink: float | None = None

    @property
    def name(self) -> str:
        """Return the model in words."""
        parts = [self.estimator, self.direction, f"zero {self.zero}", self.powers]
        parts += [word for word, used in (("drift", self.drift), ("gain", self.gain)) if used]
        shares = ("ridge", self.ridge), ("shrink", self.shrink)
        parts += [f"{word} {share:g}" for word, share in shares if share is not None]
        return ", ".join(parts)


@dataclass(frozen=True)
class Calibration:
    """A fitted calibration: response = matrix terms + zeros.

    matrix (W, P); zeros (W, G), G = 0, 1 or one per case in sorted order; covariance (W (P + G), W (P + G)) of
    [matrix, zeros] row by row; residuals (N, W); noise (W, W): estimated covariance of one row's residual; chi_square
    and dof under declared noise (for plain least squares: of the residuals alone).
    """

    model: CalibrationModel
    terms: Terms
    response_names: tuple[str, ...]
    matrix: NDArray
    zeros: NDArray
    covariance: NDArray
    residuals: NDArray
    noise: NDArray
    chi_square: float
    dof: float
    status: SolverStatus = SolverStatus.CONVERGED

    @property
    def sigma(self) -> NDArray:
        """Return the standard deviation (W, P) of every entry of the matrix."""
        every = np.sqrt(np.diag(self.covariance)).reshape(len(self.matrix), -1)
        return every[:, : self.matrix.shape[1]]

    @property
    def noise_ratio(self) -> float:
        """Return the noise found over the declared one; NaN where none was declared."""
        declared = self.model.estimator != "least squares" and self.dof > 0
        return float(np.sqrt(self.chi_square / self.dof)) if declared else float("nan")

    def columns(self, x: NDArray, z: NDArray) -> NDArray:
        """Return the columns (N, P + G) at inputs and covariates; zeros of single cases are left out."""
        terms = self.terms.at(x, z)
        zero = np.full((len(x), self.zeros.shape[1]), float(self.model.zero == "common"))
        return np.concatenate([terms, zero], axis=1)

    def predict(self, x: NDArray, z: NDArray) -> NDArray:
        """Return the response (N, W) at inputs (N, C); counted from the case's own zero where every case has one."""
        return self.columns(x, z) @ np.concatenate([self.matrix, self.zeros], axis=1).T
