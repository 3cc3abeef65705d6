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
# uncertainty from the other blocks. At least so many informative blocks are needed.
_LEAST_EFFECT, FEWEST_TELLING = 4.0, 2


@dataclass(frozen=True)
class BlockGain:
    """Log ratio of the densities of blocks with a cause and without it, predicted from the others, over informative
    blocks."""

    kind: BlockKind
    blocks: int
    log_gain: float


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


def block_gain(whitened: Whitened, own: slice, value: Array, possible: Sequence[EpochBlocks]) -> BlockGain | None:
    """Return the gain of a cause in blocks of the first kind with two informative blocks; None where no kind has two.

    ``own``: places of the cause among the shared unknowns; ``value`` (P,): its linear parameters as fitted, in prior
    sigmas, zero for parameters of its shape.
    """
    gram = whitened.normal_matrix
    kept = np.ones(len(gram), bool)
    kept[own] = False
    priors = slice(len(whitened.residual) - len(kept), None)
    effect = whitened.moved(_embedded(value, ~kept))
    effect[priors] = 0.0
    start = whitened.residual + effect
    start[priors][~kept] = 0.0  # parameters that are left out have no prior row
    step = np.linalg.solve(gram[np.ix_(kept, kept)], whitened.of_columns(start)[kept])
    left = start - whitened.moved(_embedded(step, kept))
    shape = whitened.own.shape[:2]
    by_epoch = [each[: shape[0] * shape[1]].reshape(shape) for each in (whitened.rest, left, effect)]
    whole = _log_determinant(gram), _log_determinant(gram[np.ix_(kept, kept)])
    for blocks in possible:
        each = (np.flatnonzero(blocks.numbers == number) for number in range(blocks.count))
        gains = [_gain_of(whitened, gram, whole, by_epoch, kept, block) for block in each]
        informative = [gain for gain in gains if gain is not None]
        if len(informative) >= FEWEST_TELLING:
            return BlockGain(blocks.kind, len(informative), float(np.sum(informative)))
    return None


def _embedded(values: Array, places: Mask) -> Array:
    """Return values (n,) at n places (G,) that are True, and zero elsewhere."""
    found = np.zeros(len(places))
    found[places] = values
    return found


def _gain_of(
    whitened: Whitened,
    gram: Array,
    whole: tuple[float, float],
    by_epoch: Sequence[Array],
    kept: Mask,
    block: Integers,
) -> float | None:
    """Return the gain in one block of epochs (b,); None where the block is not informative. ``by_epoch``: residuals
    (B, H) of fits to everything, with the cause and without, and its effect; ``kept`` (G,): unknowns except the
    cause's; ``whole``: log determinants of the normal matrix, of all unknowns and of these."""
    rest, left, effect = (each[block].ravel() for each in by_epoch)
    size = float(np.sum(effect**2))
    if size < _LEAST_EFFECT:
        return None
    own = whitened.rows_at(block).reshape(len(effect), len(kept))
    others = gram - own.T @ own
    factor = np.linalg.cholesky(others)
    uncertain = own[:, ~kept] @ _solved(factor, np.eye(len(kept))[:, ~kept]).T
    if float(np.sum(uncertain**2)) > size:
        return None
    within = np.linalg.cholesky(others[np.ix_(kept, kept)])
    return _log_density(own, whole[0], factor, rest) - _log_density(own[:, kept], whole[1], within, left)


def _log_density(rows: Array, whole: float, others: Array, rest: Array) -> float:
    """Return the log density of a block predicted from all other rows, up to a constant. ``rows`` (n, G) of the block;
    ``whole``: log determinant of the normal matrix with it; ``others`` (G, G): Cholesky factor of that without it;
    ``rest`` (n,): residuals of the fit to everything."""
    squares = float(rest @ rest + np.sum(_solved(others, rows.T @ rest) ** 2))
    return 0.5 * (2.0 * float(np.sum(np.log(np.diagonal(others)))) - whole - squares)


def _log_determinant(gram: Array) -> float:
    return float(np.linalg.slogdet(gram)[1])


def _solved(factor: Array, values: Array) -> Array:
    """Return the solution (G, ...) of a lower triangular system (G, G) for values (G, ...)."""
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(factor, values, lower=True))
