"""Predictive gain of an accepted cause in blocks of epochs that are left out: series, runs, days, regions.

Each block is predicted from all others, with the cause and without it; the gain is the log ratio of the two densities.
What the others do not determine keeps the uncertainty of its prior. So a block in which alone a cause acts does not
count against it. Source: leave-one-out predictive densities, Gelfand, Dey and Chang, Bayesian Statistics 4 (1992) 147.
Fits are linear: the final model's whitened problem, in which leaving out rows updates the normal matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.blocks import BlockKind, EpochBlocks
from truing.inference.fitted_model import FittedModel
from truing.inference.linear_problem import Whitened
from truing.inference.model import CauseT

# A block is informative if the effect there is at least this large (squares, in units of the noise) and larger than its
# uncertainty from the other blocks. At least this many informative blocks are needed.
_LEAST_EFFECT, FEWEST_TELLING = 4.0, 2
_FAR_BELOW = 3.0  # standard deviations


@dataclass(frozen=True)
class BlockGain:
    """Log ratio of the densities of blocks with a cause and without it, predicted from the others, over informative
    blocks; ``squares``: those of the part of the effect there that no other unknown explains, in units of the noise."""

    kind: BlockKind
    blocks: int
    log_gain: float
    squares: float

    @property
    def is_far_below(self) -> bool:
        """True if an effect of this size would gain far more in these blocks: half its squares, with their root as the
        standard deviation."""
        return bool(self.log_gain < self.squares / 2.0 - _FAR_BELOW * np.sqrt(self.squares))


def gain_in_blocks(
    final: FittedModel[CauseT], cause: CauseT, size: int, possible: Sequence[EpochBlocks]
) -> BlockGain | None:
    """Return the gain of a cause of the final model in blocks that are left out; None where no kind of block is
    informative.

    All parameters of the cause after the first ``size`` are its shape.
    """
    place = final.model.layout[cause.key]
    linear = np.arange(place.stop - place.start) < size
    return block_gain(final.fit.whitened, place, np.where(linear, final.fit.shared[place], 0.0), possible)


def block_gain(whitened: Whitened, place: slice, value: Array, possible: Sequence[EpochBlocks]) -> BlockGain | None:
    """Return the gain of a cause in blocks of the first kind with two informative blocks; None where no kind has two.

    ``place``: places of the cause among the shared unknowns; ``value`` (P,): its linear parameters as fitted, in prior
    sigmas, zero for parameters of its shape.
    """
    gram = whitened.normal_matrix
    others = np.ones(len(gram), bool)
    others[place] = False
    priors = slice(len(whitened.residual) - len(others), None)
    effect = whitened.moved(_embedded(value, ~others))
    effect[priors] = 0.0
    start = whitened.residual + effect
    start[priors][~others] = 0.0  # parameters that are left out have no prior row
    step = np.linalg.solve(gram[np.ix_(others, others)], whitened.of_columns(start)[others])
    residual_without = start - whitened.moved(_embedded(step, others))
    shape = whitened.own.shape[:2]
    by_epoch = [
        epochs_of_blocks[: shape[0] * shape[1]].reshape(shape)
        for epochs_of_blocks in (whitened.rest, residual_without, effect)
    ]
    log_determinants = _log_determinant(gram), _log_determinant(gram[np.ix_(others, others)])
    for blocks in possible:
        epochs_of_blocks = (np.flatnonzero(blocks.numbers == number) for number in range(blocks.count))
        gains = [_gain_of(whitened, gram, log_determinants, by_epoch, others, block) for block in epochs_of_blocks]
        informative = [gain for gain in gains if gain is not None]
        if len(informative) >= FEWEST_TELLING:
            gain, squares = np.sum(informative, axis=0)
            return BlockGain(blocks.kind, len(informative), float(gain), float(squares))
    return None


def _embedded(values: Array, places: Mask) -> Array:
    """Return values (n,) at n places (G,) that are True, and zero elsewhere."""
    embedded = np.zeros(len(places))
    embedded[places] = values
    return embedded


def _gain_of(
    whitened: Whitened,
    gram: Array,
    log_determinants: tuple[float, float],
    by_epoch: Sequence[Array],
    nuisances: Mask,
    block: Integers,
) -> tuple[float, float] | None:
    """Return the gain in one block of epochs (b,), and the squares of what no other unknown explains of the effect
    there; None where the block is not informative.

    ``by_epoch``: residuals (B, H) of fits to everything, with the cause and without, and its effect; ``nuisances``
    (G,): unknowns except the cause's; ``log_determinants``: log determinants of the normal matrix, of all unknowns and
    of these."""
    residual, residual_without, effect = (part[block].ravel() for part in by_epoch)
    size = float(np.sum(effect**2))
    if size < _LEAST_EFFECT:
        return None
    rows = whitened.rows_at(block).reshape(len(effect), len(nuisances))
    gram_without = gram - rows.T @ rows
    factor = np.linalg.cholesky(gram_without)
    uncertain = rows[:, ~nuisances] @ _solved(factor, np.eye(len(nuisances))[:, ~nuisances]).T
    if float(np.sum(uncertain**2)) > size:
        return None
    within = np.linalg.cholesky(gram_without[np.ix_(nuisances, nuisances)])
    with_it = _log_density(rows, log_determinants[0], factor, residual)
    gain = with_it - _log_density(rows[:, nuisances], log_determinants[1], within, residual_without)
    return gain, float(np.sum((residual_without - residual) ** 2))


def _log_density(rows: Array, log_determinant: float, factor: Array, residual: Array) -> float:
    """Return the log density of a block predicted from all other rows, up to a constant. ``rows`` (n, G) of the block;
    ``log_determinant``: log determinant of the normal matrix with it; ``factor`` (G, G): Cholesky factor of that
    without it; ``residual`` (n,): residuals of the fit to everything."""
    squares = float(residual @ residual + np.sum(_solved(factor, rows.T @ residual) ** 2))
    return 0.5 * (2.0 * float(np.sum(np.log(np.diagonal(factor)))) - log_determinant - squares)


def _log_determinant(gram: Array) -> float:
    return float(np.linalg.slogdet(gram)[1])


def _solved(factor: Array, values: Array) -> Array:
    """Return the solution (G, ...) of a lower triangular system (G, G) for values (G, ...)."""
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(factor, values, lower=True))
