"""Errors of a 6-UPUR platform by each error source on its own, and by all (force-sensor paper, section 3, figures 8-9).

First-order figures need one solve. Drawn sensors, solved without linearisation, show the scatter of a hundred samples,
and the error that 95 % of all sensors do not exceed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.six_upur.assembly import SOURCES, closed_loop_map, comprehensive, open_chain_map
from truing.simulation.bench.six_upur.geometry import JointCentres
from truing.simulation.bench.six_upur.tolerances import Band, first_order_covariances, rms_band, sampled_errors

ALL = "all"
SAMPLES = 100  # of each source, as in the paper
_MANY = 1 << 14  # sensors for quantiles
_COVERED = 0.95


@dataclass(frozen=True)
class SourceErrors:
    """Errors of the platform by S sources with tolerance, and, last, by all at once; (S + 1, 2): position, m, attitude,
    rad.

    sources: their names, the last one ALL; first_order: rms; samples (S + 1, 2, SAMPLES): drawn errors; band: their rms
    with its 95 % interval; covered: error that 95 % of all sensors do not exceed; shares (S + 1, 2): of the variance of
    all; open_chains: rms of the mean of six open chains, the paper's eq. 14, in which length errors cause no rotation.
    """

    sources: tuple[str, ...]
    first_order: NDArray
    samples: NDArray
    band: Band
    covered: NDArray
    shares: NDArray
    open_chains: NDArray


def source_errors(joints: JointCentres, sigma: NDArray, rng: np.random.Generator) -> SourceErrors:
    """Return the errors by sources of sigma (5,), m, one for each of SOURCES, 0 without tolerance.

    Raises ValueError without any tolerance, for six legs that do not hold the platform, and for tolerances with which
    legs do not close.
    """
    active = np.flatnonzero(sigma)
    if not len(active):
        raise ValueError("a tolerance above 0")
    try:
        by_source = closed_loop_map(joints)
        only = [np.where(np.arange(len(sigma)) == k, sigma, 0.0) for k in active]
        drawn = [sampled_errors(joints, source_sigma, _MANY, rng) for source_sigma in (*only, sigma)]
    except np.linalg.LinAlgError:
        raise ValueError("six legs that hold the platform") from None
    norms = np.stack([comprehensive(errors) for errors in drawn])
    if not np.isfinite(norms).all():
        raise ValueError("tolerances with which the legs close")
    first_order = _rms(by_source, sigma)[[*active, -1]]
    few = norms[..., :SAMPLES]
    return SourceErrors(
        (*(SOURCES[k] for k in active), ALL),
        first_order,
        few,
        rms_band(few),
        np.quantile(norms, _COVERED, axis=-1),
        (first_order / first_order[-1]) ** 2,
        _rms(open_chain_map(joints), sigma)[[*active, -1]],
    )


def _rms(error_map: NDArray, sigma: NDArray) -> NDArray:
    """Return the rms (6, 2) of position and attitude by each source, and by all."""
    covariance = first_order_covariances(error_map, sigma)
    parts = [np.trace(covariance[:, part, part], axis1=1, axis2=2) for part in (slice(3), slice(3, 6))]
    variance = np.stack(parts, -1)
    return np.sqrt(np.concatenate([variance, variance.sum(0, keepdims=True)]))
