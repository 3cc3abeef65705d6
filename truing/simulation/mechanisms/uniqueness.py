"""Proof, by interval arithmetic, that a platform has one pose for its readings within a range of poses.

Legs are straight: |p + R b - c| = L. If two poses X and Y of the range have equal readings, subtracting their closures
gives, exactly,

    (m - c + K S b) . (p_X - p_Y) + (S b x (m - c)) . w = 0    for every leg,

Here m is the midpoint of the positions, and S the rotation halfway between X and Y. The vector w is along the axis of
the rotation from X to Y. K differs from the identity by at most 1 - cos of half the angle of that rotation.

The readings determine the pose if these rows, over all m and S of the range, have no common kernel. With K = I they are
the rows of the machine's Jacobian: where the pose is unique, no pose is singular.

Ranges are boxes of positions and of Cayley's parameters g = tan(angle / 2) axis. The halfway rotation lies in the same
box, because its g is a weighted mean of those of X and Y. Boxes that are not decided are halved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interval_arithmetic import (
    IntervalArray,
    concatenate,
    cross,
    dot,
    hull,
    intervals,
    is_regular,
    product,
    stack,
    tangent_of_half,
)
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import closure_rows, inverse, leg_vectors, unit

PROVABLE = ("6-pus", "ups")
_PIECE = 4096  # boxes treated at once
_MOST_BOXES = 20_000
_ROUNDING = 1e-13  # relative: more than what the reference pose and its products are rounded by


@dataclass(frozen=True)
class PoseBox:
    """Range of poses about the reference pose p (3,), R (3, 3): half ranges of position (3,), m, rotation vector (3,),
    rad, and readings (L,) about rho0, m."""

    p: NDArray
    R: NDArray
    position: NDArray
    rotation: NDArray
    readings: NDArray

    @property
    def half(self) -> NDArray:
        """Half widths (6,) in position, m, and in Cayley's parameters, rounded up."""
        size = float(np.nextafter(np.linalg.norm(self.rotation) * (1.0 + _ROUNDING), np.inf))
        stretch = tangent_of_half(size) / (size * (1.0 - _ROUNDING)) if size else 0.5
        return np.concatenate([self.position, self.rotation * stretch]) * (1.0 + _ROUNDING)


@dataclass(frozen=True)
class Flexures:
    """Flexures at both ends of L legs, straight in the reference pose: lengths (L,), m, and beta (L,) of eq. 15."""

    length: NDArray
    beta: NDArray


@dataclass(frozen=True)
class UniquenessProof:
    """Statements proven over a box of poses; ``boxes``: parts examined.

    unique: two poses of the box never have equal readings; regular: no pose is singular; undecided (U, 2, 6): ends of
    the parts without proof of uniqueness, position, m, and Cayley's parameters; reading_slope (L, 2): bounds of the
    derivative of a leg's closure by its reading, positive if one reading at most closes a leg (report, eq. 18);
    singular (6,): a part's middle where the determinant has the other sign than at the reference, None without one.
    """

    unique: bool
    regular: bool
    boxes: int
    undecided: NDArray
    reading_slope: NDArray
    singular: NDArray | None

    @property
    def inverse_unique(self) -> NDArray:
        """True if at most one reading closes each leg (L,), over all poses and readings of the box."""
        return np.asarray(self.reading_slope[:, 0] > 0.0)


@dataclass(frozen=True)
class _Rows:
    """Rows of the difference of two closures, over boxes of midpoints; extra (L, 6): part of the flexures.

    length (L,): of the legs over all readings; kappa: largest difference of K from the identity.
    """

    legs: Legs
    box: PoseBox
    b: IntervalArray
    c: IntervalArray
    length: IntervalArray
    kappa: float
    extra: IntervalArray

    def decide(self, low: NDArray, high: NDArray, *, one_pose: bool = False) -> NDArray:
        """True where boxes low, high (N, 6) hold no midpoint of two poses with equal readings of the range.

        The vector g of a leg at the midpoint is the mean of those at the two poses, hence no longer.
        one_pose: decide instead if they hold no singular pose; g is then as long as the leg.
        """
        g, moment = self._parts(low, high, one_pose)
        regular = is_regular(concatenate([g, moment]) - self.extra)
        distance = _length(g)
        out = distance.low > self.length.high
        if one_pose:
            out = out | (distance.high < self.length.low)
        return np.asarray(regular | out.any(-1))

    def at(self, low: NDArray, high: NDArray, *, one_pose: bool = False) -> IntervalArray:
        """Return rows (N, L, 6) over boxes low, high (N, 6); one_pose: of the Jacobian, where both poses are equal."""
        return concatenate(list(self._parts(low, high, one_pose))) - self.extra

    def _parts(self, low: NDArray, high: NDArray, one_pose: bool) -> tuple[IntervalArray, IntervalArray]:
        x = hull(low, high)
        arm = _turned(x[:, None, 3:], self.b)
        towards = intervals(self.box.p) + x[:, None, :3] - self.c
        g = towards + arm
        if not one_pose:
            near = 0.5 * self.kappa
            total = arm.magnitude.sum(-1, keepdims=True) * (1.0 + _ROUNDING)
            g = g + arm * hull(-self.kappa, 0.0) + hull(-near * total, near * total)
        return g, cross(arm, towards)


def prove_uniqueness(
    legs: Legs, box: PoseBox, flexures: Flexures | None = None, most: int = _MOST_BOXES
) -> UniquenessProof:
    """Prove statements on straight legs, 6-pus or ups, over a box of poses by interval arithmetic.

    With ``flexures``, lengths follow the report's eq. 14 to 18. Raises ValueError for another type of leg.
    """
    if legs.closure.name not in PROVABLE:
        raise ValueError(f"legs of type {' or '.join(PROVABLE)}, not {legs.closure.name}")
    with np.errstate(invalid="ignore", over="ignore"):  # NaN of unbounded intervals proves nothing
        return _proof(legs, box, flexures, most)


def _proof(legs: Legs, box: PoseBox, flexures: Flexures | None, most: int) -> UniquenessProof:
    half = box.half
    rows, slope = _prepared(legs, box, hull(-half, half), flexures)
    lever = np.repeat([1.0, 2.0 * np.abs(legs.b).max()], 3)  # m per m, and per Cayley's parameter
    decided, boxes, undecided = _halved(rows.decide, half, lever, most)
    regular, singular = True, None
    if not decided:
        regular, _, parts = _halved(partial(rows.decide, one_pose=True), half, lever, most)
        singular = _singular(legs, box, parts[:, 0], parts[:, 1])
    return UniquenessProof(decided, regular, boxes, undecided, slope, singular)


def _prepared(legs: Legs, box: PoseBox, motion: IntervalArray, flexures: Flexures | None) -> tuple[_Rows, NDArray]:
    """Return the rows with the terms common to all midpoints, and the slopes by the readings."""
    size = float(np.abs(legs.b).max())
    turned = legs.b @ box.R.T
    b = hull(turned - _ROUNDING * size, turned + _ROUNDING * size)
    rho = hull(legs.rho0 - box.readings, legs.rho0 + box.readings)
    driven = "u" in legs.closure.geometry
    c = intervals(legs.a) + rho[:, None] * intervals(legs.u) if driven else intervals(legs.a)
    squared = motion[3:].squared().sum(-1)
    kappa = float((2.0 * squared / (1.0 + squared)).high)
    arm = _turned(motion[3:], b)
    g = intervals(box.p) + motion[:3] + arm - c
    length = _length(g)
    z = g / length[:, None]
    along = dot(z, intervals(legs.u)) if driven else intervals(np.ones(legs.count))
    extra = intervals(np.zeros((legs.count, 6)))
    reach = intervals(legs.l) if driven else intervals(legs.l) + rho
    if flexures is not None:  # 0 to 3/2 l_b at each end, less l_b
        reach = reach + intervals(flexures.length) * hull(-1.0, 2.0)
    if flexures is not None:
        extra, change = _bending(legs, box, motion, (arm, length, z), flexures)
        along = along + change if driven else along
    return _Rows(legs, box, b, c, reach, kappa, extra), np.stack([along.low, along.high], -1)


def _length(vectors: IntervalArray) -> IntervalArray:
    """Return the lengths (...) of vectors (..., n)."""
    return vectors.squared().sum(-1).root()


def _bending(
    legs: Legs,
    box: PoseBox,
    motion: IntervalArray,
    seen: tuple[IntervalArray, IntervalArray, IntervalArray],
    flexures: Flexures,
) -> tuple[IntervalArray, IntervalArray]:
    """Return the flexures' part of the rows (L, 6), and of the slope of a leg's closure by its reading (L,).

    A leg is longer by l_b (root - lean) / 2 at each end; lean = (1 - 2 beta) cos(bend); root = sqrt(3 - 4 beta +
    lean^2) (eq. 16, 17).
    """
    arm, length, z = seen
    lower = legs.closure.lower(legs, legs.rho0)
    straight = box.p + legs.b @ box.R.T - lower
    straight = straight / np.linalg.norm(straight, axis=-1, keepdims=True)
    start = hull(straight - _ROUNDING, straight + _ROUNDING)
    turned = _turned(motion[3:], start)
    terms: list[IntervalArray] = []
    beta = intervals(flexures.beta)
    share = 1.0 - 2.0 * beta
    for direction in (start, turned):
        cosine = dot(z, direction).overlap(hull(-1.0, 1.0))
        lean = share * cosine
        root = (lean.squared() + (3.0 - 4.0 * beta)).root()
        change = intervals(-flexures.length) * share * ((root - lean) / 2.0) / root
        terms.append((direction - cosine[:, None] * z) * (change / length)[:, None])
        by_turn = change
    sideways = terms[0] + terms[1]
    squared = motion[3:].squared().sum(-1)
    faster = 1.0 + squared  # angle / sine = (1 + t^2) arctan(t) / t for t = tan(angle / 2), at most |g|
    turning = (cross(arm, sideways) + by_turn[:, None] * cross(turned, z)) * hull(1.0, faster.high)
    extra = concatenate([sideways, turning]) * length[:, None]
    return extra, -dot(sideways, intervals(legs.u))


def _turned(g: IntervalArray, vectors: IntervalArray) -> IntervalArray:
    """Return vectors rotated by Cayley's parameters: v + 2 (g x v + g x (g x v)) / (1 + g g)."""
    x, y, w = (g[..., k] for k in range(3))
    sq = [part.squared() for part in (x, y, w)]
    scale = 1.0 / (1.0 + g.squared().sum(-1))
    matrix = stack(
        [
            stack([1.0 - 2.0 * (sq[1] + sq[2]) * scale, 2.0 * (x * y - w) * scale, 2.0 * (x * w + y) * scale]),
            stack([2.0 * (x * y + w) * scale, 1.0 - 2.0 * (sq[0] + sq[2]) * scale, 2.0 * (y * w - x) * scale]),
            stack([2.0 * (x * w - y) * scale, 2.0 * (y * w + x) * scale, 1.0 - 2.0 * (sq[0] + sq[1]) * scale]),
        ],
        -2,
    )
    return product(matrix, vectors[..., None])[..., 0]


def _halved(
    decides: Callable[[NDArray, NDArray], NDArray], half: NDArray, lever: NDArray, most: int
) -> tuple[bool, int, NDArray]:
    """Return True if all parts of a box are decided, their number, and the ends (U, 2, 6) of the undecided ones.

    lever (6,): motion of the joints per coordinate; the widest one is halved.
    """
    low, high, boxes = -half[None], half[None], 0
    while len(low):
        if boxes + len(low) > most:
            return False, boxes, np.stack([low, high], 1)
        open_ = ~np.concatenate(
            [decides(low[k : k + _PIECE], high[k : k + _PIECE]) for k in range(0, len(low), _PIECE)]
        )
        boxes, low, high = boxes + len(low), low[open_], high[open_]
        widest = np.argmax((high - low) * lever, -1)
        middle = (0.5 * (low + high))[np.arange(len(low)), widest]
        upper, lower = low.copy(), high.copy()
        upper[np.arange(len(low)), widest] = middle
        lower[np.arange(len(low)), widest] = middle
        low, high = np.concatenate([low, upper]), np.concatenate([lower, high])
    return True, boxes, np.empty((0, 2, 6))


def _singular(legs: Legs, box: PoseBox, low: NDArray, high: NDArray) -> NDArray | None:
    """Return the middle (6,) of a part with readings within the range, where the Jacobian's determinant has the
    opposite sign to the reference; None without one."""
    if legs.count != 6 or not len(low):
        return None
    middles = np.concatenate([np.zeros((1, 6)), 0.5 * (low + high)])
    p, R = box.p + middles[:, :3], _turned(intervals(middles[:, None, 3:]), intervals(np.eye(3))).mid
    R = np.swapaxes(R, -1, -2) @ box.R
    with np.errstate(invalid="ignore"):
        rho = inverse(legs, p, R)
        sign = np.sign(np.linalg.det(closure_rows(legs, R, unit(leg_vectors(legs, p, R, rho)))))
        within = (np.abs(rho - legs.rho0) <= box.readings).all(-1)
    opposite = np.flatnonzero(within & (sign == -sign[0]))
    return middles[opposite[0]] if len(opposite) else None
