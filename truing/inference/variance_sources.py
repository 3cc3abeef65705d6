"""Sources of variance: the rows of a whitened problem that belong to each, and its part of a covariance."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass

import numpy as np

from truing.inference.arrays import Array, Mask
from truing.inference.linear_problem import Whitened

# Sources of variance besides the kinds of shared unknowns, which have names of their own.
OBSERVATIONS, INPUTS, PRIOR_CAMPAIGN = "observations", "inputs", "earlier"
PLAUSIBLE, WIDE = "plausible", "wide"


@dataclass(frozen=True)
class Contribution:
    """Contribution of one source to the covariance (P, P) of some parameters, SI, and the redundancy of its rows."""

    source: str
    covariance: Array
    freedom: float


def rows_by_source(whitened: Whitened, layout: Mapping[str, slice], causes: Set[str], inputs: slice) -> dict[str, Mask]:
    """Return the rows (N,) of each source; every row belongs to exactly one.

    Priors of causes belong to ``PLAUSIBLE``, priors that are no knowledge to ``WIDE``, others to their kind in the
    layout.
    """
    problem = whitened.problem
    epochs, height = problem.residual.shape
    tall = height + problem.local_value.shape[1]
    first, extra = epochs * tall, len(problem.extra_residual)
    indices = np.arange(len(whitened.residual))
    within, of_epoch = indices % tall, indices < first
    shared = indices - first - extra
    # An error that the measurements of an epoch share counts as theirs, though it has an unknown of its own.
    of_observations = np.concatenate([np.ones(height, bool), problem.local_known])
    of_observations[height + inputs.start : height + inputs.stop] = False
    found = {
        OBSERVATIONS: of_epoch & of_observations[within],
        INPUTS: of_epoch & (within >= height + inputs.start) & (within < height + inputs.stop),
        PRIOR_CAMPAIGN: ~of_epoch & (shared < 0),
        PLAUSIBLE: np.zeros(len(indices), bool),
    }
    known = np.concatenate([np.zeros(first + extra, bool), problem.shared_known])
    for name, own in layout.items():
        is_owned = (shared >= own.start) & (shared < own.stop)
        if name in causes:
            found[PLAUSIBLE] |= is_owned
        else:
            found[name] = is_owned & known
    found[WIDE] = ~np.any(list(found.values()), axis=0)
    return {name: own for name, own in found.items() if own.any()}
