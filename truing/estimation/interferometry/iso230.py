"""Positioning of an axis by ISO 230-2: reversal, repeatability, systematic deviation, accuracy, with
uncertainties.

Deviations x (..., P, D, C): actual minus target position at P positions, in D directions (forward, backward) and C
cycles, NaN where not measured. Scatter s with the number of readings - 1; uncertainties by Monte Carlo (JCGM 101),
because most of the quantities are maxima.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index

FORWARD, BACKWARD = 0, 1
# Least usual time (s) from target to target that leaves the axis at rest, and fewest targets that show it.
_REST_S, _FEWEST = 1.0, 8
# Spreads, relative to the median, of steps that differ and of speeds that do not.
_UNEVEN, _ONE_SPEED = 0.1, 0.05


@dataclass(frozen=True)
class Positioning:
    """Quantities of ISO 230-2, clause 3, in the unit of the deviations; leading dimensions (...) are kept.

    At positions: mean (..., P, 2) of each direction, scatter (..., P, 2), reversal_at (..., P): forward minus backward,
    repeatability_at (..., P, 2) and bidirectional_at (..., P). Of the axis: reversal B, mean_reversal, repeatability
    (..., 2) and bidirectional_repeatability R, systematic (..., 2) and bidirectional_systematic E, mean_deviation M,
    accuracy (..., 2) and bidirectional_accuracy A.
    """

    mean: Array
    scatter: Array
    reversal_at: Array
    repeatability_at: Array
    bidirectional_at: Array
    reversal: Array
    mean_reversal: Array
    repeatability: Array
    bidirectional_repeatability: Array
    systematic: Array
    bidirectional_systematic: Array
    mean_deviation: Array
    accuracy: Array
    bidirectional_accuracy: Array


def positioning(deviation: ArrayLike) -> Positioning:
    """Return the quantities for deviations (..., P, 2, C) in both directions; those of a scatter are NaN for a
    single reading.

    Raises ValueError for fewer than two cycles, or a position without a reading from one side.
    """
    x = np.asarray(deviation, float)
    if x.ndim < 3 or x.shape[-2] != 2 or x.shape[-1] < 2:
        raise ValueError(f"deviation {x.shape}: expected (..., positions, 2 directions, at least 2 cycles)")
    known = np.isfinite(x)
    if known.all():
        return _positioning(x.mean(-1), x.std(-1, ddof=1))
    count = known.sum(-1)
    if not count.all():
        raise ValueError("deviation: expected a reading of every position from both sides")
    mean = np.where(known, x, 0.0).sum(-1) / count
    square = np.where(known, x - mean[..., None], 0.0) ** 2
    scatter = np.where(count > 1, np.sqrt(square.sum(-1) / np.maximum(count - 1, 1)), np.nan)
    return _positioning(mean, scatter)


def _positioning(mean: Array, scatter: Array) -> Positioning:
    reversal_at = mean[..., FORWARD] - mean[..., BACKWARD]
    repeatability_at = 4.0 * scatter
    both = 2.0 * scatter.sum(-1) + np.abs(reversal_at)
    bidirectional_at = np.maximum(both, repeatability_at.max(-1))
    high, low = mean + 2.0 * scatter, mean - 2.0 * scatter
    return Positioning(
        mean=mean,
        scatter=scatter,
        reversal_at=reversal_at,
        repeatability_at=repeatability_at,
        bidirectional_at=bidirectional_at,
        reversal=np.abs(reversal_at).max(-1),
        mean_reversal=reversal_at.mean(-1),
        repeatability=repeatability_at.max(-2),
        bidirectional_repeatability=bidirectional_at.max(-1),
        systematic=np.ptp(mean, axis=-2),
        bidirectional_systematic=mean.max((-1, -2)) - mean.min((-1, -2)),
        mean_deviation=np.ptp(mean.mean(-1), axis=-1),
        accuracy=high.max(-2) - low.min(-2),
        bidirectional_accuracy=high.max((-1, -2)) - low.min((-1, -2)),
    )


def is_in_motion(command: Array, time_s: Array) -> bool:
    """Return True if rows (N,) in order of time were recorded while the axis moved, and not at rest at targets.

    The targets follow each other within less than a second, or uneven steps took times in proportion to them.
    """
    begins = np.flatnonzero(np.diff(command, prepend=np.nan) != 0.0)
    step, period = np.abs(np.diff(command[begins])), np.diff(time_s[begins])
    is_known = np.isfinite(step) & (period >= 0.0)
    step, period = step[is_known], period[is_known]
    if len(step) < _FEWEST or not period.any():
        return False
    if np.median(period) < _REST_S:
        return True
    return bool(period.all()) and _spread(step) > _UNEVEN and _spread(step / period) < _ONE_SPEED


def _spread(values: Array) -> float:
    """Return the range of the middle 80 % of positive values over their median."""
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return float((high - low) / middle)


@dataclass(frozen=True)
class InstrumentUncertainty:
    """Standard uncertainties of the instrument and its surroundings.

    scale: relative, common to the whole test (wavelength, device); expansion_sigma (1/K) with warmer_by (K above 20
    degrees), temperature_sigma (K) with expansion (1/K): both stretch the axis; misalignment (rad): largest angle of
    the beam, which shortens readings; drift: of a reading since the start of its cycle, in the deviations' unit.
    """

    scale: float = 0.0
    expansion: float = 0.0
    expansion_sigma: float = 0.0
    temperature_sigma: float = 0.0
    warmer_by: float = 0.0
    misalignment: float = 0.0
    drift: float = 0.0

    @property
    def stretch(self) -> float:
        """Relative standard deviation of every length along the axis."""
        parts = self.scale, self.warmer_by * self.expansion_sigma, self.expansion * self.temperature_sigma
        return float(np.linalg.norm(parts))


@dataclass(frozen=True)
class Uncertain:
    """A quantity: value, standard uncertainty, and 95 % interval."""

    value: float
    sigma: float
    low: float
    high: float


QUANTITIES = {
    "B": "reversal",
    "R": "bidirectional_repeatability",
    "E": "bidirectional_systematic",
    "M": "mean_deviation",
    "A": "bidirectional_accuracy",
}


def positioning_uncertainty(
    deviation: ArrayLike,
    target: ArrayLike,
    rng: np.random.Generator,
    instrument: InstrumentUncertainty | None = None,
    draws: int = 4000,
) -> dict[str, Uncertain]:
    """Return B, R, E, M and A of one test with their uncertainties.

    deviation (P, 2, C), target (P,) in the same unit. Draws vary the means and scatters of each position and direction,
    uncertain with few cycles, and the errors of the instrument. Values are those of ``positioning``: maxima of noisy
    numbers are too large on average, which the intervals allow for.
    """
    x, at = np.asarray(deviation, float), np.asarray(target, float)
    figures = positioning(x)
    cycles = np.isfinite(x).sum(-1)
    if cycles.min() < 2:
        raise ValueError("deviation: expected two readings of every position from both sides")
    freedom = cycles - 1
    # simulated repetitions with the found values as truth show spread and bias
    scatter = figures.scatter * np.sqrt(rng.chisquare(freedom, (draws, *figures.scatter.shape)) / freedom)
    off = figures.scatter / np.sqrt(cycles) * rng.standard_normal(scatter.shape)
    by_instrument = _by_instrument(at, instrument or InstrumentUncertainty(), rng, draws, cycles)
    drawn = _positioning(figures.mean + off + by_instrument, scatter)
    # the scatter of the means is estimated from few cycles: Student's distribution
    wider = off / np.sqrt(rng.chisquare(freedom, scatter.shape) / freedom)
    wider_figures = _positioning(figures.mean + wider + by_instrument, scatter)
    out = {}
    for symbol, field in QUANTITIES.items():
        value = float(getattr(figures, field))
        low, high = np.quantile(getattr(wider_figures, field), [0.025, 0.975])
        sigma = float(np.std(getattr(drawn, field)))
        out[symbol] = Uncertain(value, sigma, max(0.0, 2.0 * value - float(high)), 2.0 * value - float(low))
    return out


def _by_instrument(
    at: Array, instrument: InstrumentUncertainty, rng: np.random.Generator, draws: int, cycles: Index
) -> Array:
    """Return errors (draws, P, 2) of mean deviations: from the axis' length, the beam's angle, and drift."""
    along = at - at[0]
    stretch = instrument.stretch * rng.standard_normal((draws, 1))
    angle = instrument.misalignment * rng.standard_normal((draws, 1))
    lengths = (stretch - 0.5 * angle**2) * along
    drift = instrument.drift / np.sqrt(cycles) * rng.standard_normal((draws, len(at), 2))
    return lengths[..., None] + drift
