"""How much of what legs are off by they have in common: told by how far their parameters moved.

A tolerance is one number, of legs of one bar as of legs made one by one. A parameter's variance is that of a part that
all legs share and of a part of each leg's own; which share is common is learned from the same fit. What a fit tells of
the parameters does not hang on their prior, so that the evidence for any share follows from the fit with one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Angles whose squared cosine is the share in common, all equally likely beforehand (Jeffreys' prior of a share). At the
# ends a part is a thousandth of what it may be, which no bench sees, and not nothing: so a fit can still tell of it.
_END = 1e-3
_ANGLES = np.linspace(0.0, 0.5 * np.pi, 10).clip(_END, 0.5 * np.pi - _END)
_SAME = 0.02  # rad: nothing to fit anew for


def told_share(shift: NDArray, covariance: NDArray, common: NDArray, share: float) -> float:
    """Return the share in common that a fit speaks for, on average over all; the present one where it is nearly that.

    Parameters, of which ``common`` (P,) are those of all legs, moved by shift (P,) and are known to covariance (P, P),
    both in prior sigmas with the present share.
    """
    precision = np.linalg.inv(covariance)
    told, moved = precision - np.eye(len(shift)), precision @ shift
    present = _angle(share)
    evidence = np.array([_log_evidence(told, moved, _widths(common, one, present)) for one in _ANGLES])
    weights = np.exp(evidence - evidence.max())
    angle = float(weights @ _ANGLES / weights.sum())
    return share if abs(angle - present) < _SAME else float(np.cos(angle) ** 2)


def _angle(share: float) -> float:
    return float(np.arccos(np.sqrt(share)))


def _widths(common: NDArray, angle: float, present: float) -> NDArray:
    """Return the prior sigmas (P,) at an angle over those at the present one."""
    return np.where(common, np.cos(angle) / np.cos(present), np.sin(angle) / np.sin(present))


def _log_evidence(told: NDArray, moved: NDArray, width: NDArray) -> float:
    """Return the log evidence for prior sigmas (P,), of data that tell ``told`` (P, P) and whose score is ``moved``."""
    posterior = np.eye(len(width)) + width[:, None] * told * width
    score = width * moved
    return float(0.5 * (score @ np.linalg.solve(posterior, score) - np.linalg.slogdet(posterior)[1]))
