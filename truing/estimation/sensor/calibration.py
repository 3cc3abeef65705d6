"""A sensor's calibration: terms, the matrix G_B and what belongs to it, by several estimators, in two directions.

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

Powers = Literal["linear", "squares", "products"]
Estimator = Literal["least squares", "weighted", "errors in both"]
Direction = Literal["direct", "forward"]
Zero = Literal["none", "common", "case"]


@dataclass(frozen=True)
class Terms:
    """Terms in C inputs x and K covariates z: x always; z itself (``drift``), z x (``gain``), and powers of x.

    ``squares`` adds every x_c^2, ``products`` every x_c x_d as well. The zero is no term: see `CalibrationModel`.
    """

    inputs: tuple[str, ...]
    covariates: tuple[str, ...] = ()
    drift: bool = False
    gain: bool = False
    powers: Powers = "linear"

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the name of each term (P,)."""
        names = list(self.inputs)
        names += list(self.covariates) if self.drift else []
        names += [f"{z} {x}" for z in self.covariates for x in self.inputs] if self.gain else []
        first, second = self._pairs
        return (*names, *(_power(self.inputs[i], self.inputs[j]) for i, j in zip(first, second, strict=True)))

    @property
    def _pairs(self) -> tuple[NDArray, NDArray]:
        count = len(self.inputs)
        if self.powers == "products":
            return np.triu_indices(count)
        every = np.arange(count if self.powers == "squares" else 0)
        return every, every

    def at(self, x: NDArray, z: NDArray) -> NDArray:
        """Return the terms (N, P) at inputs (N, C) and covariates (N, K)."""
        first, second = self._pairs
        parts = [x]
        parts += [z] if self.drift else []
        parts += [(z[:, :, None] * x[:, None]).reshape(len(x), -1)] if self.gain else []
        return np.concatenate([*parts, x[:, first] * x[:, second]], axis=1)

    def by_inputs(self, x: NDArray, z: NDArray) -> NDArray:
        """Return their derivatives (N, P, C) by the inputs."""
        count = len(self.inputs)
        eye, (first, second) = np.eye(count), self._pairs
        parts = [np.broadcast_to(eye, (len(x), count, count))]
        parts += [np.zeros((len(x), z.shape[1], count))] if self.drift else []
        parts += [(z[:, :, None, None] * eye).reshape(len(x), -1, count)] if self.gain else []
        powers = x[:, first, None] * eye[second] + x[:, second, None] * eye[first]
        return np.concatenate([*parts, powers], axis=1)


def _power(first: str, second: str) -> str:
    return f"{first}^2" if first == second else f"{first} {second}"


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
