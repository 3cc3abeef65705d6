"""Decisions of the search on noise: which observations or inputs scatter more than declared, and the inputs of this
dependence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from truing.inference.adequacy import is_like_noise, p_value_of_order
from truing.inference.arrays import Array, Mask
from truing.inference.attribution import p_value_of_dependence
from truing.inference.choice import is_real
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
from truing.inference.heavy_tails import (
    HEAVY,
    has_heavy_tails,
    is_of_place,
    log_odds_of_tails,
    p_value_of_repeats,
)
from truing.inference.model import CauseT, ScatterCandidate
from truing.inference.noise import NoiseDependence, NoiseLevel, noise_level, scale_gain, variance_gain
from truing.inference.rounds import Round
from truing.inference.verdicts import Reason

# Log likelihood by which scatter must exceed the log odds of the best cause to be preferred.
_UNSTRUCTURED = 5.0
# p-values of correlation between neighbours: below the first, larger residuals are an effect and no scatter; above the
# second, they are noise.
_ORDERED, _SURELY_NOISE = 0.01, 0.05


@dataclass(frozen=True)
class NoiseSelection(Generic[CauseT]):
    """Tests of one campaign's noise and scatter on the fits of a ``Fitter``, at given p-values."""

    fitter: Fitter[CauseT]
    level: float  # p-value below which a cause is real
    noise_level: float  # p-value below which noise is larger than declared
    dependence_level: float  # p-value below which noise depends on something

    def noisy_periods(self, first: Round[CauseT], kinds: Sequence[CauseT]) -> list[NoiseDependence]:
        """Weight observations that are noisier for some time, if this is far more probable than any cause with a mean
        effect."""
        noise_dependence = self.fitter.noise_dependence(first.fitted, kinds, self.dependence_level)
        if noise_dependence is None or noise_dependence.driver.cause is None:
            return []
        rest, mask = self.fitter.known_residuals(first.fitted), noise_dependence.driver.values > 0.5
        gain = rest.shape[-1] * variance_gain(np.mean(rest**2, -1), mask)
        if not self._outdoes_causes(rest, mask, first, gain):
            return []
        return [self._weighted(first.fitted, noise_dependence, kinds)]

    def outright_scatter(
        self, first: Round[CauseT], scatter: tuple[ScatterCandidate[CauseT], float]
    ) -> tuple[ScatterCandidate[CauseT], float] | None:
        """Return a cause that makes inputs scatter, with its p-value, if it is far more probable than a cause with a
        mean effect."""
        inputs_mask, residuals = scatter[0].own, first.fitted.input_residuals.standardised(scatter[0].own)
        # Next to the noise that serves the evidence of causes: it may be too large, as the effect is part of it.
        gain = scale_gain(residuals[..., 0] ** 2, inputs_mask)
        return scatter if self._outdoes_causes(residuals, inputs_mask, first, gain) else None

    def scatter(
        self, final: FittedModel[CauseT], kinds: Sequence[CauseT]
    ) -> tuple[ScatterCandidate[CauseT], float] | None:
        """Return the cause that makes inputs scatter most significantly, and its p-value; None where there is none."""
        return self.fitter.scatter(final, kinds, self.dependence_level)

    def _weighted(
        self, fitted: FittedModel[CauseT], noise_dependence: NoiseDependence, kinds: Sequence[CauseT]
    ) -> NoiseDependence:
        """Weight observations by a noise dependence; a cause of it is doubted where an effect without a name may act
        instead."""
        mask, rest = noise_dependence.driver.values > 0.5, self.fitter.known_residuals(fitted)
        doubt = ""
        if noise_dependence.driver.cause is not None:
            is_noise = is_like_noise(rest, mask, fitted, _SURELY_NOISE)
            tried = self.fitter.scatter_count(fitted, kinds, of_inputs=False)
            doubt = self._doubt(rest, mask, fitted, tried, self.dependence_level) if is_noise else Reason.UNNAMED
        return replace(self.fitter.with_noise_dependence(fitted, noise_dependence), doubt=doubt)

    def doubt_of_inputs(self, fitted: FittedModel[CauseT], inputs_mask: Mask, kinds: Sequence[CauseT]) -> str:
        """Return the reason to doubt that inputs ``inputs_mask`` (B, H) scatter; empty where there is none.

        Scatter is as uncorrelated as noise, as far as enough epochs tell, and more probable than a dependence on any
        input.
        """
        tried = self.fitter.scatter_count(fitted, kinds, of_inputs=True)
        residuals = fitted.input_residuals.standardised(inputs_mask)
        of_order = p_value_of_order(residuals, inputs_mask, fitted)
        if of_order is not None and of_order <= _SURELY_NOISE:
            return Reason.NOT_RANDOM
        return self._doubt(residuals, inputs_mask, fitted, tried, 1.0)

    @staticmethod
    def doubt_of_tails(fitted: FittedModel[CauseT], inputs_mask: Mask) -> str:
        """Return the reason to doubt that the inputs ``inputs_mask`` (B, H) scatter in all epochs; empty where there is
        none.

        Their prior is as wide as their scatter, so a few large errors may have looked like gross errors before."""
        residuals = fitted.input_residuals.standardised(inputs_mask)
        return "" if log_odds_of_tails(residuals[..., 0][inputs_mask] ** 2, 1) < HEAVY else Reason.NOT_RANDOM

    def _doubt(self, rest: Array, mask: Mask, fitted: FittedModel[CauseT], tried: int, least: float) -> str:
        """Return the reason to doubt that errors (B, K, d) in places ``mask`` (B, K), one of those ``tried``, scatter;
        empty where there is none.

        Scatter is normal, larger than elsewhere next to heavy tails, different at repeats, and of no input: the p-value
        of a dependence is at least ``least``.
        """
        if not is_of_place(rest, mask, tried):
            return Reason.NOT_RANDOM if has_heavy_tails(rest, mask) else Reason.WEAK
        repeats = self.fitter.repeats
        is_random = repeats is None or p_value_of_repeats(rest, mask, repeats) > _ORDERED
        return "" if is_random and p_value_of_dependence(rest, mask, fitted) >= least else Reason.NOT_RANDOM

    def dependences(self, final: FittedModel[CauseT], kinds: Sequence[CauseT], most: int) -> list[NoiseDependence]:
        """Return up to ``most`` dependences of the noise, one after the other.

        After each one, the same causes are fitted to the newly weighted observations; a new search follows only at the
        end.
        """
        noise_dependences: list[NoiseDependence] = []
        level = self.dependence_level
        while len(noise_dependences) < most and (more := self.fitter.noise_dependence(final, kinds, level)):
            noise_dependences.append(self._weighted(final, more, kinds))
            if len(noise_dependences) < most:
                final = self.fitter.converged(final.causes, final)
        return noise_dependences

    def _outdoes_causes(self, rest: Array, mask: Mask, first: Round[CauseT], gain: float) -> bool:
        """Return True if extra scatter of residuals (B, K, d) in a mask (B, K) is far more probable than the best
        cause. ``gain`` is that of the log likelihood. The residuals there must also be uncorrelated. Causes that
        were accepted first would each absorb some of the scatter, and the data would seem to hold several of them."""
        real = (c for c in first.best.values() if is_real(first, c, self.level))
        if gain <= max((first.posterior(c) for c in real), default=0.0) + _UNSTRUCTURED:
            return False
        return is_like_noise(rest, mask, first.fitted, _ORDERED)

    def noisy_channels(self, final: FittedModel[CauseT]) -> Iterator[tuple[int, NoiseLevel]]:
        """Yield the channels of an instrument with noise larger than declared; p-values are corrected for their number.

        Nothing is tested where observations are in space: each channel has too few of them.
        """
        index = np.flatnonzero(final.measured.is_observed.any(0)) if final.measured.size == 1 else ()
        for channel in index:
            only = np.arange(final.measured.is_observed.shape[1]) == channel
            level = noise_level(final.fit.whitened, final.measured, self.fitter.declared, only)
            if (p_value := min(1.0, level.p_value * len(index))) <= self.noise_level:
                yield int(channel), replace(level, p_value=p_value)
