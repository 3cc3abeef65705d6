"""A model with some causes, fitted to the calibration epochs, with its residuals and prediction errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic

import numpy as np

from truing.inference.arrays import Array
from truing.inference.fit import Fit
from truing.inference.model import CauseT, Model, PartialDesign, SceneLike
from truing.inference.noise import NoiseComponents, components, informative_residuals, input_squares, standardised
from truing.inference.observations import Observations
from truing.inference.prediction import DeclaredNoise, NoiseFloor, PredictionError, noise_floor, prediction_error
from truing.inference.scatter import InputResiduals, input_residuals
from truing.inference.signatures import Pathways, pathways_of
from truing.inference.variance_sources import Contribution, rows_by_source


@dataclass(frozen=True)
class FittedModel(Generic[CauseT]):
    """A model fitted to the calibration epochs, with its residuals there and its prediction errors on
    held-out epochs."""

    causes: tuple[CauseT, ...]
    model: Model[CauseT]
    measured: Observations
    fit: Fit
    held_out: PredictionError[CauseT] | None
    seed: int
    learned: tuple[float, float] = (1.0, 1.0)  # noise of inputs and survey used in the fit, over the declared one
    declared: Array | None = None  # declared covariance of the observations, if the fit's is estimated

    @cached_property
    def error(self) -> PredictionError[CauseT]:
        """Error of its prediction from inputs."""
        return prediction_error(self.model, self.measured, self.fit.frames, self.fit.shared)

    @cached_property
    def floor(self) -> NoiseFloor:
        """Part of that error that the declared noise alone explains."""
        covariance = self.measured.covariance if self.declared is None else self.declared
        declared = DeclaredNoise(covariance, 1.0 / self.learned[0])
        return noise_floor(self.model, self.fit, self.measured, declared, np.random.default_rng(self.seed))

    @cached_property
    def scene(self) -> SceneLike[CauseT]:
        """Candidates that the campaign offers, restricted to its measurements."""
        return self.model.scene.with_observed(self.measured.is_observed)

    @cached_property
    def design_matrix(self) -> Callable[[CauseT], Mapping[str, Array]]:
        """Function that returns the design of a candidate by pathway, linearised at this fit."""
        return self.model.design_matrix(self.fit.shared, self.fit.local)

    @cached_property
    def partial_designs(self) -> Callable[[CauseT], Mapping[str, Array | PartialDesign]]:
        """Function that returns the same design, where it may hold only the places that a candidate moves."""
        return self.model.partial_designs(self.fit.shared, self.fit.local)

    @property
    def input_rows(self) -> slice:
        """Places of the inputs among an epoch's local unknowns."""
        first = self.fit.frames.size
        return slice(first, first + int(np.sum(~self.model.unpredicted)))

    @cached_property
    def noise(self) -> NoiseComponents:
        """Noise of the fit's residuals by component."""
        return components(self.fit.whitened, epoch_height(self.measured), self.input_rows)

    @cached_property
    def input_residuals(self) -> InputResiduals:
        """Residuals of the fit's inputs."""
        return input_residuals(self.fit.whitened, epoch_height(self.measured), self.input_rows)

    @property
    def noise_ratio(self) -> float:
        """Noise found over the noise used in the fit, with the declared noise as prior."""
        noise = self.noise
        return float(np.sqrt((noise.observed_total + noise.inputs_total) / (noise.observed + noise.inputs)))

    @cached_property
    def standardised(self) -> Array:
        """Residuals (B, K, d) scaled to unit noise, NaN where unseen or where the redundancy is too small."""
        residuals, redundancy = informative_residuals(self.fit.whitened, self.measured.values.shape)
        return np.where(self.measured.is_observed[..., None], standardised(residuals, redundancy), np.nan)

    @property
    def input_noise(self) -> tuple[float, float]:
        """Noise of the inputs over the declared one, and its degrees of freedom; (1, 0) where the fit
        determines none."""
        squares, freedom = input_squares(self.fit.whitened, epoch_height(self.measured), self.input_rows)
        return (self.learned[0] * float(np.sqrt(squares / freedom)), freedom) if freedom > 0.0 else (1.0, 0.0)

    def covariance(self) -> Array:
        """Return the covariance (G, G) of the shared unknowns in prior sigmas, at the estimated noise level."""
        return self.fit.whitened.covariance() * self.noise_ratio**2

    def release(self) -> None:
        """Free the large arrays of a fit that another one replaces; they are computed anew where they are needed."""
        _ = self.floor, self.noise  # which need them
        self.fit.release()
        self.__dict__.pop("pathways", None)
        for error in (self.error, self.held_out):
            if error is not None:
                error.release()

    @cached_property
    def pathways(self) -> Pathways:
        """Pathways through which candidates act on the residuals."""
        motions = self.model.pathways(self.fit.shared, self.fit.local)
        return pathways_of(self.fit.whitened, self.measured, self.fit.frames, motions, self.input_rows)

    def values(self, cause: CauseT) -> tuple[Array, Array]:
        """Return the values (P,) and covariance (P, P), SI, of an accepted cause's parameters."""
        place, sigma = self.model.layout[cause.key], self.model.effect_sigma(cause)
        return self.fit.shared[place] * sigma, self.covariance()[place, place] * np.outer(sigma, sigma)

    def contributions(self, cause: CauseT) -> tuple[Contribution, ...]:
        """Return the contribution of each source to the covariance of an accepted cause's parameters, SI; they sum to
        the whole."""
        sigma = self.model.effect_sigma(cause)
        return tuple(
            replace(given, covariance=given.covariance * np.outer(sigma, sigma))
            for given in self.contributions_to(self.model.layout[cause.key])
        )

    def contributions_to(self, place: slice) -> tuple[Contribution, ...]:
        """Return the contribution of each source to the covariance of some shared unknowns; they sum to the whole."""
        whitened = self.fit.whitened
        rows = rows_by_source(whitened, self.model.layout, {cause.key for cause in self.causes}, self.input_rows)
        redundancy = np.where(whitened.present, 1.0 - whitened.leverage, 0.0)
        return tuple(
            Contribution(name, covariance * self.noise_ratio**2, float(redundancy[rows[name]].sum()))
            for name, covariance in whitened.covariance_from(rows, place).items()
        )


def epoch_height(measured: Observations) -> int:
    """Return the number of rows of an epoch's observations."""
    return int(measured.is_observed.shape[1]) * measured.size


def observation_residuals(fit: Fit, measured: Observations) -> Array:
    """Return the whitened residuals (B, K, d) of the observations of a fit."""
    epochs, height_observed = len(measured.is_observed), epoch_height(measured)
    height = height_observed + fit.whitened.problem.local_value.shape[1]
    rows = fit.whitened.rest[: epochs * height].reshape(epochs, height)[:, :height_observed]
    return rows.reshape(*measured.is_observed.shape, -1)
