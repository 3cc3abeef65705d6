"""Signatures of candidate effects: how the rows of a whitened problem follow them, free of what nuisances explain.

A candidate acts through channels, which are few (a reading of each leg, a shift of each attachment, a point): the
channels are projected once, and a candidate is a design over them, a thin matrix per pose. Thousands of candidates
then cost one small matrix each, and a search over simulated residuals one product.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.inference.linear_problem import Whitened
from truing.inference.observations import Frames, MeasuredPoints, whitened_columns

# Directions in which a plausible effect stays below this many sigma carry no test.
_INFORMATIVE = 0.3
POINTS = "points"
# Where an effect moves less than this share of the squares that it moves elsewhere, it does not act.
_MOVED = 1e-3


@dataclass(frozen=True)
class _Part:
    """Some channels: what shared unknowns explain of them, their products, and those in the readings' rows."""

    shared: NDArray  # (B, n, G)
    gram: NDArray  # (B, n, n)
    reading_gram: NDArray


@dataclass(frozen=True)
class Channels:
    """All channels of a fit side by side, whitened; ``columns`` (B, M + H, C) are free of local unknowns.

    ``shared`` (B, G, C) is what of them the shared unknowns explain, ``gram`` (B, C, C) their products pose by pose,
    ``reading_gram`` the part of these in the rows of the readings' priors.
    """

    whitened: Whitened
    places: dict[str, slice]
    columns: NDArray
    shared: NDArray
    gram: NDArray
    reading_gram: NDArray

    def along(self, rows: NDArray) -> NDArray:
        """Return the parts (D, B, C) of residuals (D, N) along the channels, to the precision of the residuals."""
        columns, shared, basis = self._of_precision(rows.dtype)
        poses, height, _ = columns.shape
        own = rows[:, : poses * height].reshape(len(rows), poses, height)
        part = np.matmul(own.transpose(1, 0, 2), columns)
        explained = ((rows @ basis) @ shared).reshape(len(rows), poses, -1)
        return np.subtract(part.transpose(1, 0, 2), explained, out=explained)

    def _of_precision(self, kind: Any) -> tuple[NDArray, NDArray, NDArray]:
        """Return columns, what is shared of them and its basis: draws need half the digits, and half the time."""
        exact = self.columns, self._shared_wide, self.whitened.basis
        return exact if kind == np.float64 else self._rough

    @cached_property
    def _rough(self) -> tuple[NDArray, NDArray, NDArray]:
        return (
            self.columns.astype(np.float32),
            self._shared_wide.astype(np.float32),
            self.whitened.basis.astype(np.float32),
        )

    @cached_property
    def _shared_wide(self) -> NDArray:
        return self.shared.transpose(1, 0, 2).reshape(self.shared.shape[1], -1)

    def index(self, names: tuple[str, ...]) -> NDArray:
        """Return where the named channels stand, in that order."""
        return np.concatenate([np.arange(self.places[name].start, self.places[name].stop) for name in names])

    def part(self, index: NDArray) -> _Part:
        """Return what concerns the channels that an index names."""
        key = index.tobytes()
        if key not in self._parts:
            shared = self.shared_by_channel[:, index]
            grams = (self._products(gram, index) for gram in (self.gram, self.reading_gram))
            self._parts[key] = _Part(shared, *grams)
        return self._parts[key]

    @cached_property
    def shared_by_channel(self) -> NDArray:
        """Return what the shared unknowns explain, (B, C, G): channels are picked by the thousand."""
        return np.ascontiguousarray(np.swapaxes(self.shared, 1, 2))

    def _products(self, gram: NDArray, index: NDArray) -> NDArray:
        """Return the rows and columns (B, n, n) of products that an index names: a copy unless they are neighbours."""
        if len(index) and np.all(np.diff(index) == 1):
            return gram[:, index[0] : index[-1] + 1, index[0] : index[-1] + 1]
        return gram[np.ix_(np.arange(len(gram)), index, index)]

    @cached_property
    def _parts(self) -> dict[bytes, _Part]:
        return {}


def channels_of(
    whitened: Whitened,
    measured: MeasuredPoints,
    frames: Frames,
    motions: Mapping[str, NDArray],
    reading_rows: slice,
) -> Channels:
    """Return a fit's channels from their motions (B, K, d, C_i) of the points; the points themselves come last.

    ``reading_rows`` tells which of a pose's local unknowns are readings.
    """
    wide = [whitened_columns(measured, frames, motion) for motion in motions.values()]
    each = measured.whitener @ frames.R[:, None]
    wide.append(_blocks(each))
    names = (*motions, POINTS)
    ends = np.cumsum([part.shape[-1] for part in wide])
    places = {n: slice(int(end) - w.shape[-1], int(end)) for n, w, end in zip(names, wide, ends, strict=True)}
    together = np.concatenate(wide, -1)
    height = together.shape[1]
    local = whitened.local_basis
    by_local = np.swapaxes(local[:, :height], 1, 2) @ together
    columns = -local @ by_local
    columns[:, :height] += together
    first = height + reading_rows.start
    readings = columns[:, first : first + reading_rows.stop - reading_rows.start]
    shared, gram = _products(whitened, together[..., : places[POINTS].start], each)
    gram -= np.swapaxes(by_local, 1, 2) @ by_local
    return Channels(whitened, places, columns, shared, gram, np.swapaxes(readings, 1, 2) @ readings)


def _products(whitened: Whitened, moved: NDArray, each: NDArray) -> tuple[NDArray, NDArray]:
    """Return the products (B, G, C) of the shared basis, which is free of local unknowns, with channels, and those
    (B, C, C) of these with each other, local unknowns included; the channels are motions moved (B, d K, m), then points
    one by one, each (B, K, d, d)."""
    poses, height, count = moved.shape
    tall = whitened.local_basis.shape[1]
    basis = whitened.basis[: poses * tall].reshape(poses, tall, -1)[:, :height]
    left = np.concatenate([basis, moved], -1) if count else np.ascontiguousarray(basis)
    turned = np.swapaxes(each, 2, 3)
    of_points = (turned @ left.reshape(*each.shape[:3], -1)).reshape(left.shape)
    found = np.concatenate([np.swapaxes(moved, 1, 2) @ left, of_points], 1)
    shared, others = found[..., : basis.shape[-1]], found[..., basis.shape[-1] :]
    gram = np.empty((poses, count + height, count + height))
    gram[:, :, :count] = others
    gram[:, :count, count:] = np.swapaxes(others[:, count:], 1, 2)
    gram[:, count:, count:] = _blocks(turned @ each)
    return np.swapaxes(shared, 1, 2), gram


def _blocks(blocks: NDArray) -> NDArray:
    """Return the matrices (B, d K, d K) with blocks (B, K, d, d) on their diagonals."""
    poses, count, size, _ = blocks.shape
    full = np.zeros((poses, count, size, count, size))
    each = np.arange(count)
    full[:, each, :, each] = blocks.transpose(1, 0, 2, 3)
    return full.reshape(poses, size * count, size * count)


@dataclass(frozen=True)
class Signature:
    """A candidate's signature: independent directions, each a combination of its parameters.

    ``strengths`` (r,) are the signal-to-noise ratios of a plausible effect along them, ``loadings`` (P, r) the
    parameters' side, ``design`` maps the channels at ``index`` to the parameters (B * C, P); ``explained`` (G, P) is
    what of the columns the shared unknowns explain, ``reading_share`` the share of the evidence that rests on the
    readings.
    """

    index: NDArray
    design: NDArray
    explained: NDArray
    gram: NDArray  # (P, P)
    strengths: NDArray
    loadings: NDArray
    reading_share: float

    @property
    def rank(self) -> int:
        """Return the number of directions in which the campaign sees the candidate."""
        return len(self.strengths)

    @property
    def parameters(self) -> int:
        """Return the number of parameters P."""
        return len(self.gram)

    @property
    def unit_design(self) -> NDArray:
        """Return the design (B * C, r) whose scores have unit variance where there is no effect."""
        return self.design @ (self.loadings / self.strengths)

    def rows(self, channels: Channels) -> NDArray:
        """Return its directions as orthonormal rows (N, r) of the whitened problem, free of what nuisances explain."""
        poses = len(channels.columns)
        own = channels.columns[:, :, self.index] @ self.unit_design.reshape(poses, len(self.index), -1)
        full = np.zeros((len(channels.whitened.rest), self.rank))
        full[: own.shape[0] * own.shape[1]] = own.reshape(-1, self.rank)
        return full - channels.whitened.basis @ (self.explained @ (self.loadings / self.strengths))

    def share_on(self, channels: Channels, other: Signature) -> float:
        """Return the share of what it moves, in squares, that lies where another moves something as well."""
        mine, theirs = self._moved_squares(channels), other._moved_squares(channels)
        shared = mine[theirs > _MOVED * theirs.max(initial=0.0)].sum()
        return float(shared / max(float(mine.sum()), 1e-300))

    def _moved_squares(self, channels: Channels) -> NDArray:
        """Return by how much it moves each coordinate of the points at every pose (B, d K), in squares."""
        place = channels.places[POINTS]
        rows = channels.columns[:, : place.stop - place.start, self.index]
        return np.asarray(np.sum((rows @ self.design.reshape(len(rows), len(self.index), -1)) ** 2, -1))

    def fitted(self, along: NDArray) -> NDArray:
        """Return the parameters (P,), in plausible scales, that fit scores along the unit design (r,) best."""
        return np.asarray(self.loadings @ (along / self.strengths))


_UNSEEN = Signature(
    np.zeros(0, int), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), 0.0
)


def signature(channels: Channels, designs: Mapping[str, NDArray]) -> Signature:
    """Return the signature of a candidate from its designs (B or 1, C_i, P) by channel, per plausible scale."""
    poses = len(channels.columns)
    names = tuple(name for name in channels.places if name in designs)
    parts = [np.broadcast_to(designs[name], (poses, *designs[name].shape[1:])) for name in names]
    if not parts:
        return _UNSEEN
    design = np.concatenate(parts, 1)
    acting = (design != 0.0).reshape(poses, -1)  # reduced along whole rows: thousands of candidates come by
    of_channel = acting.any(0).reshape(design.shape[1:]).any(1)
    design, index = design[:, of_channel], channels.index(names)[of_channel]
    part = channels.part(index)
    during = _extent(acting.any(1))
    own = design[during]
    wide = own.reshape(-1, own.shape[-1])
    explained = (wide.T @ part.shared[during].reshape(len(wide), part.shared.shape[-1])).T
    whole = wide.T @ (part.gram[during] @ own).reshape(wide.shape)
    gram = whole - explained.T @ explained
    values, vectors = np.linalg.eigh((gram + gram.T) / 2)
    kept = values > np.maximum(_INFORMATIVE**2, 1e-9 * np.trace(whole))
    share = float(np.sum(own * (part.reading_gram[during] @ own)) / max(np.trace(whole), 1e-300))
    return Signature(
        index,
        design.reshape(-1, design.shape[-1]),
        explained,
        gram,
        np.sqrt(values[kept]),
        vectors[:, kept],
        min(max(share, 0.0), 1.0),
    )


def _extent(acting: NDArray) -> slice:
    """Return the poses from the first to the last at which a candidate acts: many do so from a pose on only."""
    poses = np.flatnonzero(acting)
    return slice(poses[0], poses[-1] + 1) if len(poses) else slice(0)


def joint(channels: Channels, first: Signature, second: Signature) -> tuple[NDArray, NDArray]:
    """Return strengths (r,) and loadings (P1 + P2, r) of two candidates together, after nuisances."""
    cross = _cross(channels, first, second) - first.explained.T @ second.explained
    gram = np.block([[first.gram, cross], [cross.T, second.gram]])
    values, vectors = np.linalg.eigh(gram)
    kept = values > np.maximum(_INFORMATIVE**2, 1e-9 * np.trace(gram))
    return np.sqrt(values[kept]), vectors[:, kept]


def _cross(channels: Channels, first: Signature, second: Signature) -> NDArray:
    poses = len(channels.columns)
    grid = np.ix_(np.arange(poses), first.index, second.index)
    left = first.design.reshape(poses, -1, first.design.shape[-1])
    right = second.design.reshape(poses, -1, second.design.shape[-1])
    return np.tensordot(left, channels.gram[grid] @ right, axes=([0, 1], [0, 1]))


@dataclass(frozen=True)
class TurnedPoints:
    """The channel of points of T targets, along the axes of their bodies' surveys; or of n points each that hold
    together, along the q ways in which these move (for a single one, its axes: n = 1, q = d).

    ``turns`` (B, T, n d, q) bring these ways to the axes of the channel, ``shared`` (B, T, q, G) is what of the channel
    the shared unknowns explain, ``gram`` (B, T, q, q) are their products.
    """

    targets: NDArray  # (T, n)
    turns: NDArray
    shared: NDArray
    gram: NDArray

    def along(self, parts: NDArray) -> NDArray:
        """Return the parts (B, T, q, D) of residuals along these ways, from those along the channel (D, B, C)."""
        (count, members), (height, _) = self.targets.shape, self.turns.shape[2:]
        own = parts.reshape(*parts.shape[:2], -1, height // members)[:, :, self.targets]
        own = own.reshape(*parts.shape[:2], count, height)
        return np.asarray(np.einsum("dbtx,btxy->btyd", own, self.turns, optimize=True))


def turned_points(
    channels: Channels, targets: NDArray, turns: NDArray, patterns: NDArray | None = None
) -> TurnedPoints:
    """Return the channel of points of targets (T,) along the axes that turns (B, K, d, d) of all targets say, or of
    targets (T, n) that hold together, along patterns (T, n, d, q) in these axes."""
    place = channels.places[POINTS]
    poses, size = len(turns), turns.shape[2]
    members = targets.reshape(len(targets), -1)
    own = turns[:, members] if patterns is None else turns[:, members] @ patterns
    height = members.shape[1] * size
    own = own.reshape(poses, len(members), height, -1)
    back = np.swapaxes(own, -1, -2)
    rows = (members[..., None] * size + np.arange(size)).reshape(len(members), height)
    shared = channels.shared_by_channel[:, place][:, rows]
    blocks = channels.gram[:, place, place][:, rows[:, :, None], rows[:, None, :]]
    return TurnedPoints(members, own, back @ shared, back @ blocks @ own)


@dataclass(frozen=True)
class ProfileSignatures:
    """Signatures of T targets with S shapes of m columns each; ``gram`` (S, T, d m, d m) after nuisances.

    ``values`` (S, B, m) are the shapes over the poses, per plausible scale.
    """

    points: TurnedPoints
    values: NDArray
    gram: NDArray
    usable: NDArray  # (S, T) where the target was seen often enough

    @property
    def parameters(self) -> int:
        """Return the number of parameters of each."""
        return self.gram.shape[-1]

    @cached_property
    def seen(self) -> NDArray:
        """Return which of them (S, T) the campaign sees in all directions."""
        return np.asarray(np.linalg.eigvalsh(self.gram)[..., 0] > _INFORMATIVE**2) & self.usable

    @cached_property
    def inverse(self) -> NDArray:
        """Return the inverse of the gram (S, T, d m, d m); zero where a candidate is not seen."""
        safe = np.where(self.seen[..., None, None], self.gram, np.eye(self.parameters))
        return np.linalg.inv(safe) * self.seen[..., None, None]

    def scores(self, along: NDArray) -> NDArray:
        """Return the scores (S, T, d m, D) of residuals given by their parts (B, T, d, D) along the points' axes."""
        poses, targets, size, draws = along.shape
        shapes = self.values.transpose(0, 2, 1).reshape(-1, poses)
        found = (shapes @ along.reshape(poses, -1)).reshape(len(self.values), -1, targets, size, draws)
        return found.transpose(0, 2, 1, 3, 4).reshape(len(self.values), targets, -1, draws)

    def squares(self, along: NDArray) -> NDArray:
        """Return by how much each candidate lowers the sum of squares, (D, S, T); along as in `scores`."""
        scores = self.scores(along)
        return np.asarray(np.sum(scores * (self.inverse @ scores), 2).transpose(2, 0, 1))


def profile_signatures(points: TurnedPoints, values: NDArray, usable: NDArray) -> ProfileSignatures:
    """Return the signatures of points with shapes values (S, B, m).

    ``usable`` (S, T) tells which targets were seen often enough for which shapes.
    """
    poses, targets, size = points.shared.shape[:3]
    shapes, count = values.shape[0], values.shape[2]
    explained = values.transpose(0, 2, 1).reshape(-1, poses) @ points.shared.reshape(poses, -1)
    explained = explained.reshape(shapes, count, targets, size, -1).swapaxes(1, 2)
    explained = explained.reshape(shapes, targets, size * count, -1)
    pairs = values[..., :, None] * values[..., None, :]
    whole = pairs.transpose(0, 2, 3, 1).reshape(-1, poses) @ points.gram.reshape(poses, -1)
    whole = whole.reshape(shapes, count, count, targets, size, size).transpose(0, 3, 1, 4, 2, 5)
    whole = whole.reshape(shapes, targets, size * count, size * count)
    return ProfileSignatures(points, values, whole - explained @ np.swapaxes(explained, -1, -2), usable)
