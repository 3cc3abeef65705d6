"""Assembly errors of a 6-UPUR sensor to first order: pose of its platform (force-sensor paper, eq. 5-15).

One leg is a Denavit-Hartenberg chain with imaginary prismatic joints, seven links from the base to the platform. Link
j shifts by a_(j-1)j along the common normal and turns by alpha_(j-1)j about it. Then it shifts by S_j along the axis
and turns by theta_j about that. The two radii are shifts of imaginary prismatic joints in directions of their own,
because the
paper's axes are not normal to them. As printed, the sums of eq. 8-9 start at S_1; here they include a_01, without which
the base's radius would have no influence. Arrays may have leading batch axes, and may be complex.

Five lengths of each leg are uncertain. The paper averages six open chains; in reality the platform is held by closed
loops, whose passive joints are free in every direction except along the legs. Both models are here; they differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import skew
from truing.simulation.bench.six_upur.geometry import JointCentres, leg_axes, outward
from truing.simulation.bench.six_upur.influence import influence_matrix

LINKS = 7
# alpha_01 .. alpha_67 of the paper, rad.
TWISTS = np.radians([0.0, 270.0, 90.0, 90.0, 90.0, 270.0, 0.0])
# theta_1 .. theta_7; the first and the two last are free to choose, as parallel axes have no common normal.
ANGLES = np.radians([0.0, 90.0, -90.0, -90.0, 90.0, 0.0, 0.0])
_ALONG_X = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class DhChain:
    """Parameters of chains (...): lengths a_01..a_67 and offsets S_1..S_7 (..., 7), m, angles and twists (..., 7), rad.

    origin (..., 3), m, and frame (..., 3, 3), columns a_01, S_0 x a_01 and S_0, in the fixed frame; first and last:
    directions (..., 3) of the shifts a_01 and a_67, in the axes they start from; tail: from the last link
    to the platform's origin (..., 3), m, in the last axes.
    """

    frame: NDArray
    a: NDArray
    S: NDArray
    theta: NDArray
    alpha: NDArray
    origin: NDArray
    first: NDArray
    last: NDArray
    tail: NDArray


@dataclass(frozen=True)
class DhLinks:
    """Links of chains, fixed frame: their ends, and the directions of their derivatives."""

    normal: NDArray  # (..., 7, 3) a_(j-1)j, about which link j twists
    shift: NDArray  # (..., 7, 3) unit direction of the length a_(j-1)j: the normal, but for imaginary joints
    axis: NDArray  # (..., 7, 3) S_j
    corner: NDArray  # (..., 7, 3) m, O'_j, end of the shift along the normal
    P: NDArray  # (..., 3) m, the platform's origin
    T: NDArray  # (..., 3, 3) axes of the last link


@dataclass(frozen=True)
class InfluenceCoefficients:
    """Derivatives (..., 6, 7) of position and rotation by lengths, offsets, angles and twists (eq. 10)."""

    a: NDArray
    S: NDArray
    theta: NDArray
    alpha: NDArray


def sensor_chains(joints: JointCentres) -> DhChain:
    """Return the chains (..., 6) of an unloaded sensor: each leads from the fixed frame to the platform's origin."""
    axes, length = leg_axes(joints.direction), joints.length
    s1, s3 = axes[..., 0], axes[..., 2]
    zero, ones = np.zeros_like(length), np.ones_like(length)
    radii = [_radius(points) for points in (joints.lower, joints.arm)]
    a = np.stack([radii[0], zero, zero, zero, zero, zero, radii[1]], -1)
    S = np.stack([zero, zero, length, zero, zero, zero, zero], -1)
    start = np.stack([s3, np.cross(s1, s3), s1], -1)  # a_12 = S_3, so that theta_1 = 0
    end = np.stack([s1, np.cross(s3, s1), s3], -1)  # a_56 = S_1
    up = np.array([0.0, 0.0, 1.0])
    return DhChain(
        start,
        a,
        S,
        ones[..., None] * ANGLES,
        ones[..., None] * TWISTS,
        joints.lower * up,
        _in_axes(start, outward(joints.lower)),
        -_in_axes(end, outward(joints.arm)),
        -_in_axes(end, joints.arm * up),
    )


def joined_links(chain: DhChain) -> DhLinks:
    """Return the links of chains, joined one after the other (eq. 5-9)."""
    T, O = chain.frame, chain.origin  # noqa: E741
    links: list[tuple[NDArray, NDArray, NDArray, NDArray]] = []
    for j in range(LINKS):
        towards = {0: chain.first, LINKS - 1: chain.last}.get(j, _ALONG_X)
        shift, normal = _rotated_vectors(T, towards), T[..., 0]
        corner = O + chain.a[..., j, None] * shift
        T = T @ _about_x(chain.alpha[..., j]) @ _about_z(chain.theta[..., j])
        O = corner + chain.S[..., j, None] * T[..., 2]  # noqa: E741
        links.append((normal, shift, T[..., 2], corner))
    normal, shift, axis, corner = (np.stack(np.broadcast_arrays(*each), -2) for each in zip(*links, strict=True))
    return DhLinks(normal, shift, axis, corner, O + _rotated_vectors(T, chain.tail), T)


def influence_coefficients(links: DhLinks) -> InfluenceCoefficients:
    """Return the derivatives of chains by their parameters, position over rotation (eq. 10)."""
    lever = links.P[..., None, :] - links.corner
    still = np.zeros_like(links.axis)
    pairs = (
        (links.shift, still),
        (links.axis, still),
        (np.cross(links.axis, lever), links.axis),
        (np.cross(links.normal, lever), links.normal),
    )
    return InfluenceCoefficients(*(np.swapaxes(np.concatenate(pair, -1), -1, -2) for pair in pairs))


def angles_between(normal: NDArray, axis: NDArray) -> NDArray:
    """Return theta_2 .. (..., n - 1), rad, of common normals (..., n, 3) about the axes (..., n - 1, 3) between them.

    Eq. 12 as corrected: the printed cosine is a cross product, and loses the sign.
    """
    before, after = normal[..., :-1, :], normal[..., 1:, :]
    sine = np.sum(axis * np.cross(before, after), -1)
    return np.arctan2(sine, np.sum(before * after, -1))


def _radius(points: NDArray) -> NDArray:
    return np.sum(points * outward(points), -1)


def _in_axes(axes: NDArray, vectors: NDArray) -> NDArray:
    return np.einsum("...ji,...j->...i", axes, vectors)


def _rotated_vectors(axes: NDArray, vectors: NDArray) -> NDArray:
    return np.einsum("...ij,...j->...i", axes, vectors)


def _about_x(angle: NDArray) -> NDArray:
    c, s, zero, ones = np.cos(angle), np.sin(angle), 0.0 * angle, 1.0 + 0.0 * angle
    return _matrix((ones, zero, zero), (zero, c, -s), (zero, s, c))


def _about_z(angle: NDArray) -> NDArray:
    c, s, zero, ones = np.cos(angle), np.sin(angle), 0.0 * angle, 1.0 + 0.0 * angle
    return _matrix((c, -s, zero), (s, c, zero), (zero, zero, ones))


def _matrix(*rows: tuple[NDArray, NDArray, NDArray]) -> NDArray:
    return np.stack([np.stack(row, -1) for row in rows], -2)


# The five error sources in the order of campaign.toml, and their names in the paper.
SOURCES = ("platform_radius", "base_radius", "lower_clearance", "middle_clearance", "sensor_installation")
CODES = ("REM", "REF", "ECP", "ECU", "IES")
# Indices of four sources among the lengths a_01..a_67: a_67, a_01, a_12, a_45. The fifth is the offset S_3.
_LENGTHS, _OFFSET = [6, 0, 1, 4], 2


@dataclass(frozen=True)
class DhErrors:
    """Errors of the parameters of each leg's chain (..., 6, 7): lengths and offsets, m, twists, rad."""

    a: NDArray
    S: NDArray
    alpha: NDArray


def errors_of_sources(errors: NDArray) -> DhErrors:
    """Convert errors of the five sources (..., 6, 5), m, to errors of the chains' parameters."""
    a, S = (np.zeros((*errors.shape[:-1], 7), errors.dtype) for _ in range(2))
    a[..., _LENGTHS], S[..., _OFFSET] = errors[..., :4], errors[..., 4]
    return DhErrors(a, S, np.zeros_like(a))


def coefficients_of(joints: JointCentres) -> InfluenceCoefficients:
    """Return the influence coefficients (..., 6, 6, 7) of an unloaded sensor's chains."""
    return influence_coefficients(joined_links(sensor_chains(joints)))


def chain_errors(coefficients: InfluenceCoefficients, errors: DhErrors) -> NDArray:
    """Return the platform error (..., 6, 6), m and rad, by each leg on its own (eq. 13)."""
    parts = ((coefficients.a, errors.a), (coefficients.S, errors.S), (coefficients.alpha, errors.alpha))
    return np.sum([np.einsum("...qj,...j->...q", slope, error) for slope, error in parts], axis=0)


def open_chain_error(chains: NDArray) -> NDArray:
    """Return the platform's error (..., 6) as the mean of errors of open chains (..., 6, 6) (eq. 14)."""
    return chains.mean(-2)


def closed_loop_error(joints: JointCentres, chains: NDArray) -> NDArray:
    """Return the platform's error (..., 6), m and rad, for closed loops of six legs with errors (..., 6, 6), to first
    order.

    A leg's five passive joints allow any motion on which its screw does no work: `$_i . error = $_i . error_i`.
    """
    rows = np.swapaxes(influence_matrix(joints), -1, -2)
    along = np.sum(rows * chains, -1)
    return np.linalg.solve(rows, along[..., None])[..., 0]


def open_chain_map(joints: JointCentres) -> NDArray:
    """Return the platform's error (..., 6, 6, 5) by leg and source, as the mean of open chains."""
    return np.moveaxis(_derivative_by_source(joints), -3, -2) / 6.0


def closed_loop_map(joints: JointCentres) -> NDArray:
    """Return the platform's error (..., 6, 6, 5), m and rad per m, by leg and source, for closed loops."""
    G = influence_matrix(joints)
    along = np.einsum("...qi,...iqk->...ik", G, _derivative_by_source(joints))
    return np.swapaxes(np.linalg.inv(G), -1, -2)[..., None] * along[..., None, :, :]


def comprehensive(error: NDArray) -> tuple[NDArray, NDArray]:
    """Return the position (...), m, and attitude error (...), rad, of platform errors (..., 6) (eq. 15)."""
    return np.sqrt(np.sum(error[..., :3] ** 2, -1)), np.sqrt(np.sum(error[..., 3:] ** 2, -1))


def _derivative_by_source(joints: JointCentres) -> NDArray:
    """Return the error at the end of each leg by each of its sources, (..., 6 legs, 6, 5)."""
    return length_of_source(coefficients_of(joints))


def length_of_source(coefficients: InfluenceCoefficients) -> NDArray:
    """Return the coefficients (..., 6, 5) of the lengths in which the sources of a leg err."""
    return np.concatenate([coefficients.a[..., _LENGTHS], coefficients.S[..., _OFFSET, None]], -1)


@dataclass(frozen=True)
class JointMotion:
    """Derivatives of joint centres by P parameters, m per unit: lower and arm (6, 3, P), origin (3, P)."""

    lower: NDArray
    arm: NDArray
    origin: NDArray


def motion_of_sources(joints: JointCentres) -> JointMotion:
    """Return the derivatives of the joints of an assembled sensor by the error sources (P = 30, leg by leg)."""
    legs, sources = 6, len(SOURCES)
    upper, base = SOURCES.index("platform_radius"), SOURCES.index("base_radius")
    moved = closed_loop_map(joints).reshape(6, legs * sources)
    lower, arm = np.zeros((2, legs, 3, legs, sources))
    index = np.arange(legs)
    lower[index, :, index, base] = outward(joints.lower)
    arm[index, :, index, upper] = outward(joints.arm)
    turned = -skew(joints.arm) @ moved[3:]
    flat = (legs, 3, legs * sources)
    return JointMotion(lower.reshape(flat), arm.reshape(flat) + turned, moved[:3])


def influence_change(joints: JointCentres, motion: JointMotion) -> NDArray:
    """Return the derivative (P, 6, 6) of G by a motion of the joints."""
    S, turn = joints.direction, _turn_across(joints, motion)
    moved = np.cross(turn, S[..., None], axis=-2)
    moment = np.cross(motion.arm, S[..., None], axis=-2) + np.cross(joints.arm[..., None], moved, axis=-2)
    return np.moveaxis(np.concatenate([moved, moment], -2), (0, 1, 2), (2, 1, 0))


def _turn_across(joints: JointCentres, motion: JointMotion) -> NDArray:
    """Return the rotations (6, 3, P) of the legs across their axes, rad per unit."""
    rod = (motion.origin + motion.arm - motion.lower) / joints.length[:, None, None]
    return np.cross(joints.direction[..., None], rod, axis=-2)
