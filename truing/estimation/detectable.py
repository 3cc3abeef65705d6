"""How large an effect has to be for a search to accept it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from truing.estimation.evidence import NOISE_PRIOR_FREEDOM, Signature, log_evidence

_DRAWS = 400
_HALVINGS = 24
_LARGEST = 1e4  # plausible scales; beyond it an effect counts as never seen


def smallest_detectable(
    signature: Signature, freedom: float, level: float, least_evidence: float, power: float = 0.8
) -> float | None:
    """Return the size, in plausible scales, that is accepted with the given power; None where none is.

    Accepted is what has a p-value below ``level`` and a log evidence of at least ``least_evidence``. The size is the
    root mean square of the parameters of a pattern in no particular direction. Simulated, alike for every size.
    """
    count, parameters = len(signature.strengths), len(signature.loadings)
    if count == 0:
        return None
    rng = np.random.default_rng(0)
    pattern = rng.standard_normal((_DRAWS, parameters))
    pattern *= np.sqrt(parameters) / np.linalg.norm(pattern, axis=1, keepdims=True)
    signal, noise = pattern @ signature.loadings * signature.strengths, rng.standard_normal((_DRAWS, count))
    low, high = 0.0, _LARGEST
    for _ in range(_HALVINGS):
        middle = np.sqrt(low * high) if low else high / 1e3
        accepted = _accepted(middle * signal + noise, signature, freedom, level, least_evidence)
        low, high = (low, middle) if accepted.mean() >= power else (middle, high)
    return None if high == _LARGEST else float(high)


def _accepted(along: NDArray, signature: Signature, freedom: float, level: float, least_evidence: float) -> NDArray:
    """Return which residuals (D, r) along a signature are accepted, the rest of the residual being unit noise."""
    from scipy.special import fdtrc

    count = along.shape[-1]
    squares, left = np.sum(along**2, -1), freedom + NOISE_PRIOR_FREEDOM - count
    total = squares + freedom - count
    p_value = fdtrc(count, left, squares / count / ((NOISE_PRIOR_FREEDOM + total - squares) / left))
    return (p_value <= level) & (log_evidence(along, signature.strengths, total, freedom) >= least_evidence)
