"""A loading campaign drawn anew: the sensor within its tolerances, zeros of runs, errors of loads, and noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.reading_causes import ReadingCause
from truing.simulation.bench.model import ReadingModel
from truing.simulation.cause import Effect

# Gross errors are so many times the noise: far beyond it, not always beyond what an effect may do.
_GROSS = 100.0


def draw_readings(
    model: ReadingModel, effects: Sequence[Effect[ReadingCause]], rng: np.random.Generator, gross: float = 0.0
) -> NDArray:
    """Return readings (B, K), SI, of a campaign of the plain model's layout, with effects hidden in it.

    All but the effects is drawn alike whatever is hidden; ``gross`` is the share of readings with gross errors.
    """
    hidden = model.with_causes([effect.cause for effect in effects])
    known = model.with_causes(())
    drawn = np.where(_is_known(known), rng.standard_normal(known.shared_size), 0.0)
    shared = known.embedded(drawn, hidden)
    for effect in effects:
        shared[hidden.layout[effect.cause.key]] = effect.values / hidden.effect_sigma(effect.cause)
    local = rng.standard_normal((len(model.conditions.load), model.local_size))
    exact = hidden.points(shared, local)[..., 0]
    sigma = model.known.sigma
    noise = sigma * rng.standard_normal(exact.shape)
    wrong = rng.random(exact.shape) < gross
    return np.asarray(exact + noise + wrong * _GROSS * sigma * rng.standard_normal(exact.shape))


def _is_known(model: ReadingModel) -> NDArray:
    """Return of which unknowns (G,) something is known; the others stay where they start."""
    nominal = np.zeros(model.shared_size), np.zeros((len(model.conditions.load), model.local_size))
    return model.predict(*nominal).shared_known
