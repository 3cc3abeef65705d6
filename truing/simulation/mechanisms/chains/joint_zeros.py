"""Joint zeros far beyond their tolerance, which a precise measurement shows before any search.

With data much finer than the tolerance, the free zero of a joint absorbs its offset almost entirely, so that the
search cannot separate them: only the tolerance itself then speaks against so large a value.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from truing.arrays import Array, Mask
from truing.inference.fit import Fit, fit_model
from truing.inference.observations import Frames, Observations
from truing.simulation.mechanisms.chains.causes import JointOffset
from truing.simulation.mechanisms.chains.model import ChainModel

# Probability that any zero of a machine within its tolerances is called an offset.
_FALSE = 0.005
# The data say something of a zero if they reduce its standard deviation below this share of its tolerance.
_REDUCED = 0.95
# Above this ratio of misfit to noise an unknown effect may have bent the zeros, and none is called an offset.
_MOST_MISFIT = 3.0


def offsets_beyond_tolerance(model: ChainModel, measured: Observations, frames: Frames) -> tuple[JointOffset, ...]:
    """Return the joints whose zeros are too far off for their tolerance, the worst first.

    The largest is released before the others are tested, because one wrong zero pulls its neighbours.
    """
    found: list[JointOffset] = []
    readings = model.free_offsets
    least = -float(ndtri(_FALSE / 2.0 / max(len(readings), 1)))
    for _ in range(len(readings)):
        new = model.with_causes([*model.causes, *found])
        fit = fit_model(new.predict, measured, frames, np.zeros(new.shared_size), _no_errors(new, measured.is_observed))
        pulls = _pulls(new, fit)
        known = {cause.joint for cause in new.causes if isinstance(cause, JointOffset)}
        pulls[[k for k, r in enumerate(readings) if model.tree.readings[r] in known]] = 0.0
        worst = int(np.argmax(np.abs(pulls), axis=0)) if len(pulls) else 0
        if not len(pulls) or abs(pulls[worst]) < least:
            break
        reading = int(readings[worst])
        found.append(JointOffset(model.tree.readings[reading], bool(model.tree.is_revolute[reading])))
    return tuple(found)


def _no_errors(model: ChainModel, is_observed: Mask) -> Array:
    return np.zeros((len(is_observed), model.local_size))


def _pulls(model: ChainModel, fit: Fit) -> Array:
    """Return each zero over its standard deviation by tolerance and data; 0 if the data do not determine it."""
    zeros = np.r_[model.layout["zeros"]]
    spread = np.diag(np.linalg.inv(fit.whitened.normal_matrix))[zeros]
    misfit = np.sqrt(np.sum(fit.whitened.rest**2) / max(fit.whitened.freedom, 1.0))
    is_determined = (spread < _REDUCED**2) & bool(misfit < _MOST_MISFIT)
    return np.asarray(np.where(is_determined, fit.shared[zeros] / np.sqrt(np.maximum(1.0 - spread, 1e-12)), 0.0), float)
