"""Search for a body in a cloud of unlabelled points: all motions that explain enough of them.

Three targets determine a motion, and three points can only be these targets if their distances agree. Triples of the
smaller set are therefore looked up among all pairs of the other set. Each hit gives a motion, which is rated by the
number of targets that it moves onto points. Motions are proper: a mirror image is no hit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb, lgamma, log
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.umeyama import umeyama

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

# A target is beyond 5 sigma (three coordinates) once in 65,000; the gate then loses it, without further harm.
GATE = 5.0
# Probability that a rival at least as good as the best is missed.
_UNSEEN = 1e-9
_MAX_SEEDS = 3000
# Motions rated in full per batch, preselected on a sample of targets: a grid of targets offers thousands.
_MOST_RATED = 96
_SAMPLE = 32
_ROLL_WEIGHT = 1e-6
_MAX_ELEMENTS = 4_000_000


@dataclass(frozen=True)
class Constellation:
    """Points (N, 3) in m with the variance (N,) in m^2 of their coordinates."""

    points: NDArray
    variance: NDArray

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def distances(self) -> NDArray:
        """Distances (N, N) in m."""
        # Relative to the centroid: far from the origin, a difference of squares loses digits.
        centred = self.points - self.points.mean(0)
        square = np.sum(centred**2, -1)
        product = square[:, None] + square - 2 * centred @ centred.T
        return np.sqrt(np.maximum(product, 0.0))

    @cached_property
    def pairs(self) -> tuple[NDArray, NDArray, NDArray]:
        """Distances of all ordered pairs in ascending order, with their first and second points."""
        first, second = np.nonzero(~np.eye(len(self), dtype=bool))
        length = self.distances[first, second]
        order = np.argsort(length, kind="stable")
        return length[order], first[order], second[order]

    @cached_property
    def extents(self) -> NDArray:
        """Ranges (3,) in m along the principal axes, longest first, at least the width of a gate."""
        _, axes = np.linalg.eigh(np.cov(self.points.T))
        ranges = np.ptp(self.points @ axes[:, ::-1], axis=0)
        return np.maximum(ranges, 2 * GATE * np.sqrt(self.variance.max()))

    @cached_property
    def on_a_line(self) -> bool:
        """True if all points are within a gate of the principal axis."""
        centred = self.points - self.points.mean(0)
        axis = np.linalg.svd(centred, full_matrices=False)[2][0]
        across = np.linalg.norm(centred - np.outer(centred @ axis, axis), axis=1)
        return bool(np.all(across <= GATE * np.sqrt(2 * self.variance)))

    @property
    def size(self) -> float:
        """Largest distance in m."""
        return float(self.distances.max())


def log_expected_accidents(cloud: Constellation, survey: Constellation, n_consistent: int) -> float:
    """Return the log of the number of ways in which n_consistent targets are expected to fit by chance.

    It counts every choice of targets and points, times the probability that points spread uniformly over the cloud's
    box lie in their gates: the first anywhere, the second on a shell, the third on a ring, the rest in a box. Moisan
    and Stival, Int. J. Computer Vision 57 (2004) 201, adapted from images to rigid bodies.
    """
    N, M, k = len(cloud), len(survey), n_consistent
    width = 2 * GATE * np.sqrt(cloud.variance.max() + survey.variance.max())
    a, b, c = np.maximum(cloud.extents, width)
    L = survey.size
    shell = width * min(2 * np.pi * L, np.pi * b) * min(c, 2 * L) / (a * b * c)
    ring = width**2 * min(2 * np.pi * L, np.pi * c) / (a * b * c)
    box = width**3 / (a * b * c)
    third = box if survey.on_a_line else ring
    log_count = log(comb(N, k)) + log(comb(M, k)) + lgamma(k + 1)
    return log_count + log(min(shell, 1.0)) + log(min(third, 1.0)) + (k - 3) * log(min(box, 1.0))


@dataclass(frozen=True)
class Hypothesis:
    """One motion of the survey into the cloud, with the points that it explains."""

    match: NDArray  # (M,) point of each target, -1 without one
    R: NDArray  # (3, 3) R_measurement_survey
    t: NDArray  # (3,) m
    gain: NDArray  # (N,) log-odds of each point for this motion against chance; 0 for points not explained
    rms: float  # m, of the consistent points

    @property
    def n_consistent(self) -> int:
        """Number of points at the place of a target."""
        return int(np.count_nonzero(self.match >= 0))

    @property
    def score(self) -> float:
        """Log-odds of all points together."""
        return float(self.gain.sum())

    @property
    def assignment(self) -> NDArray:
        """Target (N,) of each point, -1 without one."""
        labels = np.full(len(self.gain), -1)
        is_observed = self.match >= 0
        labels[self.match[is_observed]] = np.flatnonzero(is_observed)
        return labels


def contradict(cloud: Constellation, survey: Constellation, best: Hypothesis, other: Hypothesis) -> bool:
    """True if two hypotheses assign different labels, or the other explains a point out of the best one's reach.

    Hypotheses that differ only by a point at the edge of its gate agree, and so do two motions with equal labels.
    """
    best_points, other_points = best.assignment, other.assignment
    both = (best.match >= 0) & (other.match >= 0)
    if np.any(both & (best.match != other.match)) or np.any(
        (best_points >= 0) & (other_points >= 0) & (best_points != other_points)
    ):
        return True
    is_observed = (other.match >= 0) & (best.match < 0)
    distance = np.linalg.norm(
        survey.points[is_observed] @ best.R.T + best.t - cloud.points[other.match[is_observed]], axis=1
    )
    return bool(
        np.any(distance > 2 * GATE * np.sqrt(cloud.variance[other.match[is_observed]] + survey.variance[is_observed]))
    )


def find_hypotheses(cloud: Constellation, survey: Constellation, keep: int = 24) -> list[Hypothesis]:
    """Return up to ``keep`` motions, best first, that move at least three targets of the survey onto points.

    The probability to miss a motion as good as the best is below 1e-9, unless the search ran out of seeds.
    """
    from scipy.spatial import cKDTree

    search = _LabelSearch(cKDTree(cloud.points), cloud, survey)
    hypotheses: dict[bytes, Hypothesis] = {}
    smaller = min(len(cloud), len(survey))
    tried, best = 0, 0
    for seeds in _seed_batches(cloud, survey):
        tried += seeds[0]
        for hypothesis in _explained_by(search, *_strongest(search, *seeds[1:])):
            hypotheses.setdefault(hypothesis.match.tobytes(), hypothesis)
            best = max(best, hypothesis.n_consistent)
        if _chance_of_unseen(best, smaller, tried, 2 if survey.on_a_line else 3) < _UNSEEN:
            break
    ranked = sorted(hypotheses.values(), key=_rank)[:keep]
    for hypothesis in [h for first in ranked[:1] for h in _exchanged_neighbours(cloud, survey, first)]:
        if hypothesis.match.tobytes() not in hypotheses:
            ranked.append(hypothesis)
    return sorted(ranked, key=_rank)


def _rank(hypothesis: Hypothesis) -> tuple[float, bytes]:
    return -hypothesis.score, hypothesis.match.tobytes()


def _chance_of_unseen(n_consistent: int, n_base: int, tried: int, order: int) -> float:
    """Return the probability that no tried seed lies within a set of n_consistent of the n_base points."""
    if n_consistent <= order:
        return 1.0
    return float((1.0 - comb(n_consistent - 1, order) / comb(n_base, order) * (1 - 1e-12)) ** tried)


def _seed_batches(cloud: Constellation, survey: Constellation) -> Iterator[tuple[int, NDArray, NDArray]]:
    """Yield the number of seeds looked up, and the targets (B, k) and points (B, k) of every hit."""
    smaller, larger = (survey, cloud) if len(survey) <= len(cloud) else (cloud, survey)
    seeds = _seeds(smaller, 2 if survey.on_a_line else 3)
    start, step = 0, 8
    while start < len(seeds):
        chosen = seeds[start : start + step]
        row, hits = _congruent(smaller, larger, chosen)
        smaller_points = chosen[row]
        yield (len(chosen), smaller_points, hits) if smaller is survey else (len(chosen), hits, smaller_points)
        start, step = start + step, min(2 * step, 256)


def _seeds(base: Constellation, order: int) -> NDArray:
    """Return seeds (S, order) of the base in a reproducible order, each with its longest edge first."""
    n = len(base)
    rng = np.random.default_rng(0)
    if comb(n, order) <= _MAX_SEEDS:
        seeds = rng.permutation(np.array(list(combinations(range(n), order))))
    else:
        seeds = np.sort(np.argsort(rng.random((_MAX_SEEDS, n)), axis=1)[:, :order], axis=1)
    if order == 2:
        return seeds
    longest_first = _longest_edge_first(base.distances, seeds)
    solid = _altitude(base.distances, longest_first) > 2 * GATE * np.sqrt(base.variance.max())
    return longest_first[solid] if np.any(solid) else longest_first


def _longest_edge_first(D: NDArray, triples: NDArray) -> NDArray:
    """Return the triples with their longest edge between the first two."""
    turns = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1]])
    edge = np.stack([D[triples[:, a], triples[:, b]] for a, b, _ in turns], axis=1)
    return np.take_along_axis(triples, turns[np.argmax(edge, axis=1)], axis=1)


def _altitude(D: NDArray, triples: NDArray) -> NDArray:
    """Return the height in m of triangles over their first edge, the longest (Heron)."""
    c, a, b = (D[triples[:, i], triples[:, j]] for i, j in ((0, 1), (1, 2), (2, 0)))
    s = (a + b + c) / 2
    return 2 * np.sqrt(np.maximum(s * (s - a) * (s - b) * (s - c), 0.0)) / np.where(c > 0, c, 1.0)


def _congruent(smaller: Constellation, larger: Constellation, seeds: NDArray) -> tuple[NDArray, NDArray]:
    """Return seed numbers (B,) and the points of the other set (B, k) with the distances of that seed."""
    row, i, j = _agreeing_pairs(smaller, larger, seeds)
    if seeds.shape[1] == 2 or len(row) == 0:
        return row, np.stack([i, j], -1) if seeds.shape[1] == 2 else np.empty((0, 3), np.intp)
    parts, step = [], max(1, _MAX_ELEMENTS // len(larger))
    for s in range(0, len(row), step):
        at, k = _third_points(smaller, larger, seeds[row[s : s + step]], i[s : s + step], j[s : s + step])
        parts.append(np.stack([row[s : s + step][at], i[s : s + step][at], j[s : s + step][at], k], -1))
    hits = np.concatenate(parts)
    return hits[:, 0], hits[:, 1:]


def _agreeing_pairs(smaller: Constellation, larger: Constellation, seeds: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    length, first, second = larger.pairs
    a, b = seeds[:, 0], seeds[:, 1]
    wanted, noise = smaller.distances[a, b], smaller.variance[a] + smaller.variance[b]
    widest = GATE * np.sqrt(noise + 2 * larger.variance.max())
    low, high = np.searchsorted(length, wanted - widest), np.searchsorted(length, wanted + widest, side="right")
    row = np.repeat(np.arange(len(seeds)), high - low)
    pair = np.arange(len(row)) - np.repeat(np.cumsum(high - low) - high, high - low)
    i, j = first[pair], second[pair]
    gate = GATE * np.sqrt(noise[row] + larger.variance[i] + larger.variance[j])
    near = np.abs(length[pair] - wanted[row]) <= gate
    return row[near], i[near], j[near]


def _third_points(
    smaller: Constellation, larger: Constellation, seeds: NDArray, i: NDArray, j: NDArray
) -> tuple[NDArray, NDArray]:
    fits = np.ones((len(i), len(larger)), dtype=bool)
    for known, corner in ((i, seeds[:, 0]), (j, seeds[:, 1])):
        wanted = smaller.distances[corner, seeds[:, 2]]
        noise = smaller.variance[corner] + smaller.variance[seeds[:, 2]] + larger.variance[known]
        gate = GATE * np.sqrt(noise[:, None] + larger.variance)
        fits &= np.abs(larger.distances[known] - wanted[:, None]) <= gate
    rows = np.arange(len(i))
    fits[rows, i] = fits[rows, j] = False
    at, third = np.nonzero(fits)
    return at, third


def _motions(
    cloud: Constellation, survey: Constellation, targets: NDArray, points: NDArray, roll: NDArray | None = None
) -> tuple[NDArray, NDArray]:
    """Return R (B, 3, 3), t (B, 3) of targets (B, k) onto points (B, k), -1 for no point; a line's roll is fixed
    arbitrarily."""
    is_observed = points >= 0
    weight = np.where(is_observed, 1.0 / (cloud.variance[points] + survey.variance[targets]), 0.0)
    source, target = survey.points[targets], cloud.points[points]
    if survey.on_a_line:
        source, target, weight = _with_roll(source, target, weight, roll)
    fit = umeyama(source, target, weight)
    return fit.R, fit.t


def _with_roll(
    source: NDArray, target: NDArray, weight: NDArray, roll: NDArray | None
) -> tuple[NDArray, NDArray, NDArray]:
    """Append one pair of points next to the line, with a tiny weight that fixes only the free roll. A known rotation
    (B, 3, 3), ``roll``, determines the pair."""
    along_s, along_t = source[:, 1] - source[:, 0], target[:, 1] - target[:, 0]
    beside_s = _perpendicular(along_s)
    beside_t = _perpendicular(along_t) if roll is None else np.einsum("bij,bj->bi", roll, beside_s)
    total = weight.sum(1, keepdims=True)
    centres = (np.einsum("bn,bni->bi", weight, cloud) / total for cloud in (source, target))
    extra = [centre + beside for centre, beside in zip(centres, (beside_s, beside_t), strict=True)]
    return (
        np.concatenate([source, extra[0][:, None]], 1),
        np.concatenate([target, extra[1][:, None]], 1),
        np.concatenate([weight, _ROLL_WEIGHT * total], 1),
    )


def _perpendicular(v: NDArray) -> NDArray:
    """Return vectors (B, 3) of the length of v, perpendicular to it."""
    axis = np.eye(3)[np.argmin(np.abs(v), axis=1)]
    side = np.cross(v, axis)
    return side / np.linalg.norm(side, axis=1, keepdims=True) * np.linalg.norm(v, axis=1, keepdims=True)


@dataclass(frozen=True)
class _LabelSearch:
    """Search for the targets of a survey in a cloud, with a tree of the cloud's points."""

    tree: cKDTree
    cloud: Constellation
    survey: Constellation


def _strongest(search: _LabelSearch, targets: NDArray, points: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return the best seeds (targets, points) with their motions, at most _MOST_RATED, by a sample of targets."""
    cloud, survey = search.cloud, search.survey
    if len(targets) == 0:
        return targets, points, np.empty((0, 3, 3)), np.empty((0, 3))
    R, t = _motions(cloud, survey, targets, points)
    valid = np.isfinite(t).all(1)
    targets, points, R, t = targets[valid], points[valid], R[valid], t[valid]
    if len(targets) > _MOST_RATED:
        sample = np.unique(np.linspace(0, len(survey) - 1, _SAMPLE).astype(int))
        count = np.zeros(len(targets), int)
        for s in range(0, len(targets), 2000):
            part = slice(s, s + 2000)
            seed = _seed_match(targets[part], points[part], len(survey))
            match = _gated_matches(search, (R[part], t[part]), seed, sample)
            count[part] = np.count_nonzero(match >= 0, axis=1)
        best = np.sort(np.argsort(-count, kind="stable")[:_MOST_RATED])
        targets, points, R, t = targets[best], points[best], R[best], t[best]
    return targets, points, R, t


def _seed_match(targets: NDArray, points: NDArray, n_survey: int) -> NDArray:
    match = np.full((len(targets), n_survey), -1)
    np.put_along_axis(match, targets, points, axis=1)
    return match


def _explained_by(
    search: _LabelSearch, targets: NDArray, points: NDArray, R: NDArray, t: NDArray
) -> Iterator[Hypothesis]:
    """Yield the hypothesis of each motion, after refits to all points that it explains."""
    cloud, survey = search.cloud, search.survey
    match = _seed_match(targets, points, len(survey))
    everything = np.arange(len(survey))
    for _ in range(3):
        if len(match) == 0:
            return
        match = _gated_matches(search, (R, t), match, everything)
        enough = np.count_nonzero(match >= 0, axis=1) >= 3
        match, first = np.unique(match[enough], axis=0, return_index=True)
        roll = R[enough][first]
        R, t = _motions(cloud, survey, np.broadcast_to(everything, match.shape), match, roll)
        fitted = np.isfinite(t).all(1)
        match, R, t = match[fitted], R[fitted], t[fitted]
    yield from (hypothesis_at(cloud, survey, m, r, s) for m, r, s in zip(match, R, t, strict=True))


def _gated_matches(search: _LabelSearch, motion: tuple[NDArray, NDArray], match: NDArray, chosen: NDArray) -> NDArray:
    """Return the point (B, m) of each chosen target under each motion R, t; -1 if none is in its gate. The gate
    includes the uncertainty at that target of the motion fitted to the current match."""
    cloud, survey, (R, t) = search.cloud, search.survey, motion
    predicted = survey.points[chosen] @ np.swapaxes(R, 1, 2) + t[:, None]
    gate = GATE * np.sqrt(cloud.variance.max() + survey.variance[chosen] + _pose_variance(cloud, survey, match, chosen))
    distance, point = search.tree.query(predicted, distance_upper_bound=gate.max())
    point = np.where(distance <= gate, point, -1)
    return _one_to_one(point, np.where(distance <= gate, distance / gate, np.inf))


def _pose_variance(cloud: Constellation, survey: Constellation, match: NDArray, chosen: NDArray) -> NDArray:
    """Return the variance (B, m) in m^2 at the chosen targets of a motion fitted to the matched ones."""
    w = np.where(match >= 0, 1.0 / (cloud.variance[match] + survey.variance), 0.0)
    total = w.sum(1)
    centre = w @ survey.points / total[:, None]
    arm = survey.points - centre[:, None]
    scatter, axes = np.linalg.eigh(np.einsum("bn,bni,bnj->bij", w, arm, arm))
    inertia = scatter.sum(1, keepdims=True) - scatter
    if survey.on_a_line:
        inertia[:, 2] = np.inf
    u2 = np.einsum("bni,bij->bnj", survey.points[chosen] - centre[:, None], axes) ** 2
    across = u2.sum(-1, keepdims=True) - u2
    return 1.0 / total[:, None] + np.sum(across / np.maximum(inertia, 1e-30)[:, None], axis=-1)


def _one_to_one(point: NDArray, relative: NDArray) -> NDArray:
    """Return the match (B, m) with each point that several targets claim assigned to the nearest of them."""
    b, m = np.nonzero(point >= 0)
    order = np.lexsort((relative[b, m], point[b, m], b))
    b, m = b[order], m[order]
    claimed = point[b, m]
    again = np.zeros(len(b), bool)
    again[1:] = (b[1:] == b[:-1]) & (claimed[1:] == claimed[:-1])
    single = point.copy()
    single[b[again], m[again]] = -1
    return single


def hypothesis_at(cloud: Constellation, survey: Constellation, match: NDArray, R: NDArray, t: NDArray) -> Hypothesis:
    """Return the hypothesis of one match (M,) under one motion, with the log-odds of each point."""
    seen = np.flatnonzero(match >= 0)
    square = np.sum((cloud.points[match[seen]] - survey.points[seen] @ R.T - t) ** 2, axis=1)
    variance = cloud.variance[match[seen]] + survey.variance[seen]
    log_volume = np.log(np.maximum(cloud.extents, 2 * GATE * np.sqrt(variance.max()))).sum()
    gain = np.zeros(len(cloud))
    gain[match[seen]] = log_volume - 1.5 * np.log(2 * np.pi * variance) - square / (2 * variance)
    return Hypothesis(match, R, t, gain, float(np.sqrt(square.mean())))


def _exchanged_neighbours(cloud: Constellation, survey: Constellation, best: Hypothesis) -> Iterator[Hypothesis]:
    """Yield variants of the best hypothesis in which a point goes to a neighbouring target with an overlapping gate."""
    predicted = survey.points @ best.R.T + best.t
    labels = best.assignment
    labelled = np.flatnonzero(labels >= 0)
    distance = np.linalg.norm(cloud.points[labelled, None] - predicted, axis=-1)
    gate = GATE * np.sqrt(cloud.variance[labelled, None] + survey.variance)
    for row, neighbour in zip(*np.nonzero(distance <= gate), strict=True):
        point, label = labelled[row], labels[labelled[row]]
        if neighbour == label:
            continue
        match = best.match.copy()
        displaced = match[neighbour]
        match[label], match[neighbour] = -1, point
        if displaced >= 0 and np.linalg.norm(cloud.points[displaced] - predicted[label]) <= gate[row, label]:
            match[label] = displaced
        yield hypothesis_at(cloud, survey, match, best.R, best.t)
