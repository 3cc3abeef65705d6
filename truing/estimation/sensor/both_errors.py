"""A calibration as an implicit model: what was applied and what was recorded both have errors, which are eliminated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.sensor.terms import Terms


@dataclass(frozen=True)
class Equations:
    """Equations (N, W) with their derivatives by deviations (N, W, W + C) and by values (N, W, W Q)."""

    value: NDArray
    by_deviation: NDArray
    by_values: NDArray


@dataclass(frozen=True)
class TermEquations:
    """``0 = y + d_y - B [terms(x + d_x, z), zero]`` in every row; values are B (W, Q) row by row.

    response y (N, W), inputs x (N, C), covariates z (N, K), zeros (N, G): columns of the zeros.
    """

    terms: Terms
    response: NDArray
    inputs: NDArray
    covariates: NDArray
    zeros: NDArray

    def constrain(self, values: NDArray, deviation: NDArray) -> Equations:
        """Return the equations at values (W Q,) and deviations (N, W + C), those of the response first."""
        rows, width = self.response.shape
        matrix = values.reshape(width, -1)
        x = self.inputs + deviation[:, width:]
        columns = np.concatenate([self.terms.at(x, self.covariates), self.zeros], axis=1)
        slope = matrix[:, : columns.shape[1] - self.zeros.shape[1]] @ self.terms.by_inputs(x, self.covariates)
        own = np.broadcast_to(np.eye(width), (rows, width, width))
        by_values = -own[..., None] * columns[:, None, None]
        return Equations(
            self.response + deviation[:, :width] - columns @ matrix.T,
            np.concatenate([own, -slope], axis=2),
            by_values.reshape(rows, width, -1),
        )
