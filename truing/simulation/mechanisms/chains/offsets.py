"""Joint zeros far beyond their tolerance, which a precise measurement shows before any search.

Where data are much finer than the tolerance, the free zero of a joint absorbs its offset almost entirely, and the
search cannot tell the two apart: only the tolerance itself then speaks against so large a value.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from truing.arrays import Array, Mask
from truing.inference.fit import Fit, fit_model
from truing.inference.observations import Frames, Observations
from truing.simulation.mechanisms.chains.causes import JointOffset
from truing.simulation.mechanisms.chains.model import ChainModel

# Probability that any zero of a machine within its tolerances is called an offset.
_FALSE = 0.005
# A zero counts as known from the data if its standard deviation is below this share of its tolerance.
_FINE = 0.05


def offsets_beyond_tolerance(model: ChainModel, measured: Observations, frames: Frames) -> tuple[JointOffset, ...]:
    """Return the joints whose zeros are too far off for their tolerance, the worst first.

    The largest is released before the others are tested, because one wrong zero pulls its neighbours.
    """
    found: list[JointOffset] = []
    readings = model.free_offsets
    least = float(norm.isf(_FALSE / 2.0 / max(len(readings), 1)))
    for _ in range(len(readings)):
        own = model.with_causes([*model.causes, *found])
        fit = fit_model(own.predict, measured, frames, np.zeros(own.shared_size), _no_errors(own, measured.seen))
        pulls, fine = _pulls(own, fit)
        pulls[~fine] = 0.0
        pulls[[k for k, r in enumerate(readings) if model.tree.readings[r] in {one.joint for one in found}]] = 0.0
        worst = int(np.argmax(np.abs(pulls), axis=0)) if len(pulls) else 0
        if not len(pulls) or abs(pulls[worst]) < least:
            break
        reading = int(readings[worst])
        found.append(JointOffset(model.tree.readings[reading], bool(model.tree.is_revolute[reading])))
    return tuple(found)


def _no_errors(model: ChainModel, seen: Mask) -> Array:
    return np.zeros((len(seen), model.local_size))


def _pulls(model: ChainModel, fit: Fit) -> tuple[Array, Mask]:
    """Return each zero over its tolerance, and whether the data alone determine it finely, misfit included."""
    own = np.r_[model.layout["zeros"]]
    sigma = np.sqrt(np.diag(np.linalg.inv(fit.whitened.normal_matrix)))[own]
    misfit = max(np.sqrt(np.sum(fit.whitened.rest**2) / max(fit.whitened.freedom, 1.0)), 1.0)
    return np.asarray(fit.shared[own], float), np.asarray(sigma * misfit < _FINE)
