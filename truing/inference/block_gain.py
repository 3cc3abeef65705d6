"""Whether a cause that was found pays where whole blocks of epochs were left out: series, runs, days, regions.

Each block is predicted from the others with the cause and without it, as a density: by how much more probable the block
is with it. What the others do not determine is as uncertain as its prior, so that a block in which alone a cause acts
says nothing against it (leave-one-out predictive densities: Gelfand, Dey and Chang, Bayesian Statistics 4 (1992) 147).
Fits are linear here: of the final model's whitened problem, where leaving out rows is an update of its normal matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.blocks import BlockKind, EpochBlocks
from truing.inference.linear_problem import Whitened

# A block tells of a cause whose effect there is this large, in squares of the noise, and better known from the others
# than it is large. So many such blocks tell whether it holds elsewhere.
_LEAST_EFFECT, FEWEST_TELLING = 4.0, 2


@dataclass(frozen=True)
class BlockGain:
    """By how much more probable blocks are with a cause than without, predicted from the others (log); over ``blocks``
    that tell of it."""

    kind: BlockKind
    blocks: int
    log_gain: float


def block_gain(whitened: Whitened, own: slice, value: Array, possible: Sequence[EpochBlocks]) -> BlockGain | None:
    """Return the gain by a cause in blocks of the first kind of which two tell; None where no kind has as many.

    ``own``: its places among the shared unknowns; ``value`` (P,): what is linear in them, as fitted in prior sigmas,
    zero for its shape.
    """
    rows, height = whitened.rows, whitened.local_basis.shape[1]
    kept = np.ones(rows.shape[1], bool)
    kept[own] = False
    epochs = np.arange(len(whitened.local_basis) * height).reshape(-1, height)
    effect = rows[:, own] @ value
    effect[len(rows) - len(kept) :] = 0.0
    start = whitened.residual + effect
    start[len(rows) - len(kept) :][~kept] = 0.0  # nothing is known beforehand of what is left out
    gram = whitened.normal_matrix
    left = start - rows[:, kept] @ np.linalg.solve(gram[np.ix_(kept, kept)], rows[:, kept].T @ start)
    for blocks in possible:
        each = (epochs[blocks.numbers == number].ravel() for number in range(blocks.count))
        gains = [_gain_of(rows, gram, (whitened.rest, left), effect, kept, block) for block in each]
        informative = [gain for gain in gains if gain is not None]
        if len(informative) >= FEWEST_TELLING:
            return BlockGain(blocks.kind, len(informative), float(np.sum(informative)))
    return None


def _gain_of(
    rows: Array, gram: Array, rest: tuple[Array, Array], effect: Array, kept: Mask, block: Integers
) -> float | None:
    """Return the gain of one block, rows (n,) of all; None where it does not tell of the cause.

    rest: what fits to everything leave (N,), with the cause and without; kept (G,): unknowns but for the cause's.
    """
    own = rows[block]
    others = gram - own.T @ own
    size = float(np.sum(effect[block] ** 2))
    if size < _LEAST_EFFECT:
        return None
    uncertain = np.linalg.inv(others)[np.ix_(~kept, ~kept)]
    if float(np.sum((own[:, ~kept] @ uncertain) * own[:, ~kept])) > size:
        return None
    within = np.ix_(kept, kept)
    without = _log_density(own[:, kept], gram[within], others[within], rest[1][block])
    return _log_density(own, gram, others, rest[0][block]) - without


def _log_density(rows: Array, gram: Array, others: Array, rest: Array) -> float:
    """Return the log density of a block, but for a constant, predicted from all other rows.

    rows (n, G) of the block, gram and others (G, G): normal matrices with it and without, rest (n,): what the fit to
    everything leaves there.
    """
    along = rows.T @ rest
    squares = float(rest @ rest + along @ np.linalg.solve(others, along))
    return 0.5 * float(np.linalg.slogdet(others)[1] - np.linalg.slogdet(gram)[1] - squares)
