"""How a sensor stands that was not made exactly: assembly errors to first order (force-sensor paper, eq. 13-15).

Five lengths of each leg are uncertain. The paper averages six open chains; a platform is held by closed loops, whose
passive joints give way in every direction but along the legs. Both are here, and they differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.six_upur.dh_chain import (
    InfluenceCoefficients,
    follow,
    influence_coefficients,
    sensor_chains,
)
from truing.simulation.bench.six_upur.geometry import JointCentres
from truing.simulation.bench.six_upur.influence import influence_matrix

# The five error sources in the order of campaign.toml, and what the paper calls them.
SOURCES = ("platform_radius", "base_radius", "lower_clearance", "middle_clearance", "sensor_installation")
CODES = ("REM", "REF", "ECP", "ECU", "IES")
# Where they stand among the lengths a_01..a_67: a_67, a_01, a_12, a_45. The fifth is the offset S_3.
_LENGTHS, _OFFSET = [6, 0, 1, 4], 2


@dataclass(frozen=True)
class DhErrors:
    """Errors of the parameters of each leg's chain (..., 6, 7): lengths and offsets, m, twists, rad."""

    a: NDArray
    S: NDArray
    alpha: NDArray


def errors_of_sources(errors: NDArray) -> DhErrors:
    """Return errors of the five sources (..., 6, 5), m, as those of the chains' parameters."""
    a, S = (np.zeros((*errors.shape[:-1], 7), errors.dtype) for _ in range(2))
    a[..., _LENGTHS], S[..., _OFFSET] = errors[..., :4], errors[..., 4]
    return DhErrors(a, S, np.zeros_like(a))


def coefficients_of(joints: JointCentres) -> InfluenceCoefficients:
    """Return the influence coefficients (..., 6, 6, 7) of an unloaded sensor's chains."""
    return influence_coefficients(follow(sensor_chains(joints)))


def chain_errors(coefficients: InfluenceCoefficients, errors: DhErrors) -> NDArray:
    """Return where each leg alone would put the platform (..., 6, 6): m and rad, leg by leg (eq. 13)."""
    parts = ((coefficients.a, errors.a), (coefficients.S, errors.S), (coefficients.alpha, errors.alpha))
    return np.sum([np.einsum("...qj,...j->...q", slope, error) for slope, error in parts], axis=0)


def open_chain_error(chains: NDArray) -> NDArray:
    """Return the platform's error (..., 6) as the mean of errors of open chains (..., 6, 6) (eq. 14)."""
    return chains.mean(-2)


def closed_loop_error(joints: JointCentres, chains: NDArray) -> NDArray:
    """Return the platform's error (..., 6), m and rad, where six legs with errors of their own (..., 6, 6) close.

    To first order. A leg's five passive joints let it follow any motion that its screw does no work on:
    `$_i . error = $_i . error_i`.
    """
    rows = np.swapaxes(influence_matrix(joints), -1, -2)
    along = np.sum(rows * chains, -1)
    return np.linalg.solve(rows, along[..., None])[..., 0]


def open_chain_map(joints: JointCentres) -> NDArray:
    """Return the platform's error (..., 6, 6, 5) by leg and source, as the paper averages them."""
    return np.moveaxis(_by_source(joints), -3, -2) / 6.0


def closed_loop_map(joints: JointCentres) -> NDArray:
    """Return the platform's error (..., 6, 6, 5), m and rad per m, by leg and source, as closed loops have it."""
    G = influence_matrix(joints)
    along = np.einsum("...qi,...iqk->...ik", G, _by_source(joints))
    return np.swapaxes(np.linalg.inv(G), -1, -2)[..., None] * along[..., None, :, :]


def comprehensive(error: NDArray) -> tuple[NDArray, NDArray]:
    """Return the position (...), m, and attitude error (...), rad, of platform errors (..., 6) (eq. 15)."""
    return np.sqrt(np.sum(error[..., :3] ** 2, -1)), np.sqrt(np.sum(error[..., 3:] ** 2, -1))


def _by_source(joints: JointCentres) -> NDArray:
    """Return what one source of one leg does to where that leg leads (..., 6 legs, 6, 5)."""
    found = coefficients_of(joints)
    return np.concatenate([found.a[..., _LENGTHS], found.S[..., _OFFSET, None]], -1)
