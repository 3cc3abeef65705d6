"""Circular targets in a photograph: centres with covariance, ellipses, codes, and counts of rejected candidates."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.image_targets import edge_kernel as edge
from truing.estimation.image_targets.candidates import EllipseCandidates, find_candidates
from truing.estimation.image_targets.edge_kernel import SLOPE_X, SLOPE_Y
from truing.estimation.image_targets.image_noise import ImageNoise, estimate_noise
from truing.estimation.image_targets.ring_codes import ROUND, RingCode, RingReading, are_open, read_rings

# Radii relative to the dot's. The ring of a code spans 2 to 3.
_INSIDE, _BESIDE = (0.35, 0.5, 0.65), (1.4, 1.5)
_RING, _RIMS, _BEYOND = (2.35, 2.5, 2.65), (2.2, 2.8), (3.3,)
# Outer radius of the edge fit: at first; without a ring; inside a known ring.
_NEAR, _FAR, _TO_RING = 1.5, 1.9, 1.7
_HELD = 0.1  # share of the contrast by which levels are held in the first fit
_UNEVEN = 0.15  # share of samples that may be on the wrong side of half the contrast
_GROUND, _COVERED = 0.3, 0.06  # of the contrast: levels beyond a ring; share of them that may differ
_CLIPPED = 0.97  # share of the range, above which a light gradient cannot make levels lighter
_STRAY = 0.03  # share of an edge's pixels that may belong to something else
# Largest distance of an arc of the edge from its ellipse: px, or a share of the semi-major axis (paper is not flat).
_DENT, _DENT_SHARE = 0.3, 0.012
_MISFIT = 0.1  # share of the contrast, beyond the noise, left by an ellipse's picture; sharpened images have 0.05
_WORSE = 3.0  # sigmas by which arcs of a target scatter more than those of the others
_SEVERAL = 5  # targets needed to estimate a common noise from their residuals
_SOFTEST = 0.65  # blur over semi-minor axis
_AT_ONCE = 16000  # targets per call: OpenCV's maps are shorter than 2^15
_HIGHEST_EDGE = 0.8  # share of the range between ground and dot: the highest edge level in clipped light
_LARGER = 1.4  # size ratio from which two edges count as different


@dataclass(frozen=True)
class CirclePlan:
    """Search options: ring codes; dots without a code; dots lighter than their ground (white), darker or both; least
    semi-minor and largest semi-major axis, px; least ratio of the axes; least contrast as a share of the image's grey
    range."""

    codes: tuple[RingCode, ...] = ()
    uncoded: bool = True
    polarity: Literal["white", "black", "both"] = "both"
    smallest_px: float = 2.5
    largest_px: float = 120.0
    least_axis_ratio: float = 0.25
    least_contrast: float = 0.1

    @property
    def polarities(self) -> tuple[bool, ...]:
        """True for lighter dots, False for darker ones."""
        return {"white": (True,), "black": (False,), "both": (True, False)}[self.polarity]


@dataclass(frozen=True)
class ImageTargets:
    """Circular targets with the centres of their ellipses in image coordinates (first pixel's centre at (0, 0)).

    centre_px (N, 2), cov_px2 (N, 2, 2), semi_axes_px (N, 2): major one first, axis_angle_rad (N,): major axis from x
    towards y, contrast (N,) in grey levels, white (N,): dot lighter than its ground, family (N,) by number in the plan;
    and code (N,), both -1 without a code, confidence (N,) of the code from 0 to 1, blur_px (N,): standard deviation;
    counts of rejected candidates by reason; noise of the image.
    """

    centre_px: Array
    cov_px2: Array
    semi_axes_px: Array
    axis_angle_rad: Array
    contrast: Array
    white: Mask
    family: Index
    code: Index
    confidence: Array
    blur_px: Array
    rejected: Counter[str]
    noise: ImageNoise
    codes: tuple[RingCode, ...] = field(default=())

    @property
    def count(self) -> int:
        """Number of targets."""
        return len(self.code)

    @property
    def kinds(self) -> list[str]:
        """Kind of each target, by the number of segments of its ring; circle without a code."""
        return [f"ring{self.codes[k].bits}" if k >= 0 else "circle" for k in self.family]

    @property
    def names(self) -> list[str]:
        """Name of each coded target, such as ring12-17; empty without a code."""
        coded = zip(self.family, self.code, strict=True)
        return [f"{self.codes[family].family}-{code}" if code >= 0 else "" for family, code in coded]


def measure_circles(grey: NDArray, plan: CirclePlan, noise: ImageNoise | None = None) -> ImageTargets:
    """Return the circular targets of a grey image (h, w) of 8 or 16 bits; ValueError for any other array."""
    if grey.ndim != 2 or grey.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"image: found {grey.ndim} dimensions of {grey.dtype}, expected 2 of uint8 or uint16")
    noise = noise or estimate_noise(grey)
    least = plan.least_contrast * float(np.ptp(grey[::4, ::4]))
    sigma = float(np.sqrt(noise.variance(np.array(float(grey.max(initial=0))))))
    size = (plan.smallest_px, plan.largest_px)
    candidates = find_candidates(grey, plan.polarities, size, plan.least_axis_ratio, least, sigma)
    rejected = Counter(candidates.rejected)
    start = _with_clear_sides(grey, candidates, least, rejected)
    first = _fitted(grey, start, noise, np.full(len(start), _NEAR), None, _HELD)
    first = first[_accepted_candidates(_faults(first, plan, noise, least, _top(grey)), rejected)]
    reading, outer = _surroundings(grey, first, plan)
    good = _accepted_candidates(_code_faults(grey, first, reading, plan), rejected)
    reading, first = _subset(reading, good), first[good]
    last = _fitted(grey, first[:, : edge.UNKNOWNS], noise, outer[good], reading.ring, 0.0)
    good = _accepted_candidates(_faults(last, plan, noise, least, _top(grey)), rejected)
    return _targets(last[good], _subset(reading, good), rejected, noise, plan)


def _with_clear_sides(
    grey: NDArray, ellipse_candidates: EllipseCandidates, least: float, rejected: Counter[str]
) -> Array:
    """Return start values (N, 10) for candidates with an even inside and free surroundings."""
    A = unit_matrices(ellipse_candidates.semi_axes_px, ellipse_candidates.axis_angle_rad)
    inside = sample_ellipses(grey, ellipse_candidates.centre_px, A, _INSIDE, 24).reshape(len(A), 24 * len(_INSIDE))
    beside = sample_ellipses(grey, ellipse_candidates.centre_px, A, _BESIDE, 24).mean(1)
    level, ground = np.median(inside, axis=1), np.median(beside, axis=1)
    contrast = level - ground
    safe = np.where(contrast == 0, 1.0, contrast)[:, None]
    uneven = ((inside - ground[:, None]) / safe < 0.5).mean(1) > _UNEVEN
    blocked = ((beside - ground[:, None]) / safe > 0.5).mean(1) > _UNEVEN
    weak = np.where(ellipse_candidates.white, contrast, -contrast) < 0.6 * least
    good = _accepted_candidates(
        np.select([weak, uneven, blocked], ["weak contrast", "uneven inside", "no clear ground"], ""), rejected
    )
    columns = (
        ellipse_candidates.centre_px,
        A[:, 0, :],
        A[:, 1, 1:],
        np.ones((len(A), 1)),
        ground[:, None],
        contrast[:, None],
    )
    return np.concatenate([*columns, np.zeros((len(A), 2))], 1)[good]


def _fitted(grey: NDArray, start: Array, noise: ImageNoise, outer: Array, ring: Array | None, held: float) -> Array:
    """Return the fits (N, RESULTS) of blurred ellipses, from start (N, UNKNOWNS), out to outer (N,) radii."""
    results = np.zeros((len(start), edge.RESULTS))
    if len(start):
        rings = np.zeros((len(start), 1)) if ring is None else ring
        a, b = axes_of(start)[0].max(0)
        most = int(4 * (1.5 * a + 20) * (1.5 * b + 20))
        level = np.array([noise.read_var, noise.gain])
        picture = edge.Picture(grey.astype(np.uint16, copy=False), level, _top(grey))
        targets = edge.EdgeTargets(np.ascontiguousarray(start), rings, np.asarray(rings.any(1)), outer)
        edge.fit_edges(picture, targets, held, most, results)
    return results


def _top(grey: NDArray) -> float:
    """Return the highest grey level for the number of bits that the image uses, at least 8."""
    return float((1 << max(8, int(grey.max(initial=0)).bit_length())) - 1)


def _faults(fit: Array, plan: CirclePlan, noise: ImageNoise, least: float, top: float) -> NDArray[np.str_]:
    """Return the first reason to reject each fit (N, RESULTS); empty if accepted."""
    axes, _ = axes_of(fit)
    contrast = visible_contrast(fit, top)
    light = fit[:, edge.GROUND] + np.maximum(fit[:, edge.CONTRAST], 0)
    excess = fit[:, edge.MISFIT] ** 2 - noise.variance(light) / np.maximum(contrast, 1e-9) ** 2
    dent = fit[:, edge.DENT] / np.maximum(_DENT, _DENT_SHARE * axes[:, 0])
    tests = {
        "no ellipse fits": fit[:, edge.SETTLED] < 0.5,
        "weak contrast": contrast < least,
        "too small": axes[:, 1] < plan.smallest_px,
        "too large": axes[:, 0] > plan.largest_px,
        "too oblique": axes[:, 1] < plan.least_axis_ratio * axes[:, 0],
        "partly hidden": (fit[:, edge.HIDDEN] > _STRAY) | (dent < -1),
        "merged": (fit[:, edge.MERGED] > _STRAY) | (dent > 1),
        "unsharp": fit[:, edge.BLUR] > _SOFTEST * axes[:, 1],
        "not elliptical": excess > _MISFIT**2,
        "found twice": doubles(fit, axes),
    }
    return np.select(list(tests.values()), list(tests), "")


def _surroundings(grey: NDArray, fit: Array, plan: CirclePlan) -> tuple[RingReading, Array]:
    """Return the readings of rings around dots (N, RESULTS), and the radii (N,) within which all light is modelled."""
    from scipy.special import erf

    A, centre, top = matrices(fit), fit[:, :2], _top(grey)

    def levels(radii: tuple[float, ...], left: Array) -> Array:
        seen = sample_ellipses(grey, centre, A, radii, ROUND).mean(1)
        light = np.where(seen < _CLIPPED * top, np.clip(1 + np.mean(radii) * slope, 0.5, 2.0), 1.0)
        return unclipped(seen / light, fit, top, left)

    # gradient of the light, from the centre to the edge
    turn = (np.arange(ROUND) + 0.5) * 2 * np.pi / ROUND
    to_edge = np.linalg.inv(A) @ np.stack([np.cos(turn), np.sin(turn)]) * np.sqrt(np.linalg.det(A))[:, None, None]
    slope = np.einsum("ni,nik->nk", fit[:, [SLOPE_X, SLOPE_Y]], to_edge)
    # share of a narrow ring's contrast that blur leaves
    width = axes_of(fit)[0].prod(1) ** 0.5
    whole_light = np.ones(len(fit))
    ring = levels(_RING, np.maximum(erf(width / 2 / np.sqrt(2) / fit[:, edge.BLUR]), 0.5))
    # an edge across the middle of the ring: its blur in samples
    soft = fit[:, edge.BLUR] / (2.5 * width) * ROUND / (2 * np.pi)
    reading = read_rings(ring, plan.codes, soft)
    beyond = np.abs(levels(_BEYOND, whole_light))
    # a ring stands on clear ground; an object covering part of it rarely ends there
    mask, ground = (beyond < _GROUND).mean(1) > 1 - _COVERED, np.median(beyond, axis=1) < _GROUND
    if (reading.number >= 0).any():
        mask &= are_open(np.stack([levels((rim,), whole_light) for rim in _RIMS], 1), reading.ring)
    broken = (reading.number >= 0) & ~mask
    reading = replace(
        reading,
        number=np.where(broken, -1, reading.number),
        family=np.where(broken, -1, reading.family),
        ring=reading.ring * ~broken[:, None],
        unreadable=reading.unreadable & ground | broken,
    )
    free = (levels((1.7, _FAR), whole_light) < 0.3).all(1) & (ring < 0.5).all(1)
    return reading, np.select([reading.number >= 0, free], [_TO_RING, _FAR], _NEAR)


def _code_faults(grey: NDArray, fit: Array, reading: RingReading, plan: CirclePlan) -> NDArray[np.str_]:
    """Return the reason to reject dots (N, RESULTS) by their surroundings; empty if accepted."""
    coded = reading.number >= 0
    tests = {
        "at border": ~inside_image(grey, fit[:, :2], matrices(fit), 3.0) & bool(plan.codes),
        "code of two families": reading.ambiguous & reading.unreadable,
        "unreadable code": reading.unreadable & ~coded,
        "part of a ring": ~coded & on_rings(fit, coded | reading.unreadable),
        "ground of another": ~coded & about_others(fit),
        "no code": ~coded & (not plan.uncoded),
    }
    return np.select(list(tests.values()), list(tests), "")


def _subset(reading: RingReading, numbers: Index) -> RingReading:
    """Return the readings of some rings, by number."""
    return RingReading(*(getattr(reading, each.name)[numbers] for each in fields(RingReading)))


def _targets(
    fit: Array, reading: RingReading, rejected: Counter[str], noise: ImageNoise, plan: CirclePlan
) -> ImageTargets:
    """Return the targets of fits (N, RESULTS)."""
    axes, angle = axes_of(fit)
    factor = _noise_factor(fit, noise)
    covariance = fit[:, [[edge.C_XX, edge.C_XY], [edge.C_XY, edge.C_YY]]] * factor[:, None, None]
    return ImageTargets(
        fit[:, :2],
        covariance,
        axes,
        angle,
        np.abs(fit[:, edge.CONTRAST]),
        fit[:, edge.CONTRAST] > 0,
        reading.family,
        reading.number,
        reading.confidence,
        fit[:, edge.BLUR],
        +rejected,
        noise,
        plan.codes,
    )


def _noise_factor(fit: Array, noise: ImageNoise) -> Array:
    """Return factors (N,) for the covariances of centres (N, RESULTS). Neighbouring pixels share noise, and edges are
    not exact ellipses, so arcs of the edges scatter more than independent pixels. The factor comes from all targets of
    an image, or from a target that is worse itself. If no flat part of the image shows the noise, the residuals of the
    targets may lower it."""
    arcs, freedom = fit[:, edge.ARC_CHI2], fit[:, edge.ARC_FREEDOM]
    usual = noise.correlation
    if len(fit) >= _SEVERAL:
        # the median of a mean square lies below its expectation (Wilson and Hilferty, 1931)
        expected = arcs / (1 - 2 / (9 * freedom)) ** 3
        usual = max(usual * min(float(np.median(fit[:, edge.CHI2])), 1.0), float(np.median(expected)))
    return np.where(arcs > usual * (1 + _WORSE * np.sqrt(2 / freedom)), arcs, usual)


def _accepted_candidates(faults: NDArray[np.str_], rejected: Counter[str]) -> Index:
    """Return the numbers of candidates without a fault, and count the others by fault."""
    rejected.update(faults[faults != ""].tolist())
    return np.flatnonzero(faults == "")


def unit_matrices(semi_axes: Array, angle: Array) -> Array:
    """Return symmetric A (N, 2, 2) with |A (x - centre)| = 1 on ellipses of semi-axes (N, 2), angle (N,) in rad."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    return (R / semi_axes[:, None, :]) @ R.swapaxes(1, 2)


def sample_ellipses(grey: NDArray, centre: Array, A: Array, radii: tuple[float, ...], count: int) -> Array:
    """Return grey levels (N, len(radii), count), bilinear, clockwise from the x axis of the circle's plane.

    Samples lie at the middles of `count` equal arcs. Outside the image, the nearest border pixel counts.
    """
    import cv2

    flat = (len(centre), len(radii) * count)
    x, y = (points.reshape(flat).astype(np.float32) for points in _arc_points(centre, A, radii, count))
    parts = [
        cv2.remap(grey, x[k : k + _AT_ONCE], y[k : k + _AT_ONCE], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for k in range(0, len(x), _AT_ONCE)
    ]
    levels = np.concatenate(parts) if parts else np.empty(flat)
    return levels.reshape(-1, len(radii), count).astype(np.float64)


def inside_image(grey: NDArray, centre: Array, A: Array, radius: float) -> Mask:
    """Return the mask (N,) of targets whose ellipse, enlarged by `radius`, lies inside the image."""
    x, y = _arc_points(centre, A, (radius,), 32)
    rows, columns = grey.shape
    return ((x >= 0) & (y >= 0) & (x <= columns - 1) & (y <= rows - 1)).all((1, 2))


def _arc_points(centre: Array, A: Array, radii: tuple[float, ...], count: int) -> tuple[Array, Array]:
    """Return x and y (N, len(radii), count) of the middles of arcs of ellipses."""
    turn = (np.arange(count) + 0.5) * 2 * np.pi / count
    circle = np.stack([np.cos(turn), np.sin(turn)])
    along = np.linalg.inv(A) @ circle if len(A) else np.empty((0, 2, count))
    points = centre[:, :, None, None] + along[:, :, None, :] * np.asarray(radii)[:, None]
    return points[:, 0], points[:, 1]


def matrices(fit: Array) -> Array:
    """Return the matrices (N, 2, 2) that map the ellipses to unit circles."""
    return fit[:, [[edge.AXX, edge.AXY], [edge.AXY, edge.AYY]]]


def axes_of(fit: Array) -> tuple[Array, Array]:
    """Return semi-axes (N, 2), the major one first, and the angles (N,) of the major ones in (-pi/2, pi/2]."""
    values, vectors = np.linalg.eigh(matrices(fit))
    x, y = vectors[:, 0, 0], vectors[:, 1, 0]
    angle = np.arctan2(y, x)
    angle = np.where(angle > np.pi / 2, angle - np.pi, np.where(angle <= -np.pi / 2, angle + np.pi, angle))
    return 1 / np.maximum(values, 1e-12), angle


def visible_contrast(fit: Array, top: float) -> Array:
    """Return the contrast (N,) of dots (N, RESULTS) as clipped at the top of the range."""
    ground, level = fit[:, edge.GROUND], fit[:, edge.GROUND] + fit[:, edge.CONTRAST]
    return np.abs(np.minimum(level, top) - np.minimum(ground, top))


def unclipped(grey: Array, fit: Array, top: float, left: Array) -> Array:
    """Return grey levels (N, K) about dots (N, RESULTS) in units of the dots' contrast.

    0 is the ground and 1 the contrast that blur leaves (N,), both clipped at the top of the range. An edge is at half
    of the light, which is near the top of the range if the light exceeds it; clipped levels limit how well it is known.
    """
    ground, contrast = fit[:, edge.GROUND], fit[:, edge.CONTRAST]
    low, high = np.minimum(ground, top), np.minimum(ground + contrast * left, top)
    half = np.minimum(ground + contrast * left / 2, low + _HIGHEST_EDGE * (high - low))
    half = np.where(contrast > 0, half, np.minimum(ground + contrast * left / 2, high + _HIGHEST_EDGE * (low - high)))
    safe = [np.where(np.abs(span) < 1e-6, 1e-6, span)[:, None] for span in (half - low, high - half)]
    above = (grey - half[:, None]) / safe[1]
    return 0.5 + 0.5 * np.where(above > 0, above, (grey - half[:, None]) / safe[0])


def doubles(fit: Array, axes: Array) -> Mask:
    """Return the mask (N,) of fits that coincide with another, better one."""
    from scipy.spatial import cKDTree

    double = np.zeros(len(fit), bool)
    converged = np.flatnonzero(fit[:, edge.SETTLED] > 0.5)
    pairs = (
        cKDTree(fit[converged, :2]).query_pairs(4.0, output_type="ndarray") if len(converged) else np.empty((0, 2), int)
    )
    i, j = converged[pairs].T
    size = axes[:, 1]
    near = np.hypot(*(fit[i, :2] - fit[j, :2]).T) < 0.5 * np.minimum(size[i], size[j])
    near &= np.maximum(size[i], size[j]) < _LARGER * np.minimum(size[i], size[j])
    worse = np.where(fit[i, edge.MISFIT] > fit[j, edge.MISFIT], i, j)
    double[worse[near]] = True
    return double


def on_rings(fit: Array, ringed: Mask) -> Mask:
    """Return the mask (N,) of dots on the ring of another dot that has a ring (N,)."""
    from scipy.spatial import cKDTree

    owner = np.flatnonzero(ringed)
    lies = np.zeros(len(fit), bool)
    if len(owner):
        reach = 3.5 * axes_of(fit[owner])[0][:, 0]
        near = cKDTree(fit[:, :2]).query_ball_point(fit[owner, :2], reach)
        i = np.repeat(owner, [len(part) for part in near])
        j = np.concatenate(near).astype(np.int64)
        radius = np.linalg.norm(np.einsum("nij,nj->ni", matrices(fit[i]), fit[j, :2] - fit[i, :2]), axis=1)
        lies[j[(radius > 1.5) & (radius < 3.2)]] = True
    return lies


def about_others(fit: Array) -> Mask:
    """Return the mask (N,) of dots with another one at their centre: the carrier of a target."""
    from scipy.spatial import cKDTree

    size, about = axes_of(fit)[0][:, 1], np.zeros(len(fit), bool)
    pairs = cKDTree(fit[:, :2]).query_pairs(4.0, output_type="ndarray") if len(fit) else np.empty((0, 2), int)
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    distance = np.hypot(*(fit[i, :2] - fit[j, :2]).T)
    about[i[(distance < 0.5 * size[j]) & (size[i] >= _LARGER * size[j])]] = True
    return about
