"""Signatures of candidate effects: their derivatives in the rows of a whitened problem, orthogonal to the nuisances.

A candidate acts through a few pathways (an input of each part, a shift of a part, an observation). The pathways are
projected once, and a candidate is a design over them, a thin matrix per epoch. Each of thousands of candidates then
costs one small matrix, and a search over simulated residuals one product.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.linear_problem import Whitened
from truing.inference.model import OBSERVED
from truing.inference.observations import Frames, Observations, whitened_columns

# Directions in which a plausible effect stays below this many sigma are not tested.
_INFORMATIVE = 0.3
# An effect acts where its squared change is above this share of its largest one.
_MOVED = 1e-3
# Number of candidates on the same pathways that are projected by one product.
_AT_ONCE = 32
# Most values of the products of all pathways with all shared unknowns that are kept; otherwise they are formed for some
# pathways at a time.
_MOST_KEPT = 2**23


@dataclass(frozen=True)
class _Part:
    """Some pathways: their products, and their products in the inputs' rows."""

    gram: Array  # (B, n, n)
    input_gram: Array


@dataclass(frozen=True)
class Pathways:
    """All pathways of a fit side by side, whitened; ``columns`` (B, M + H, C) are free of local unknowns.

    ``shared`` (B, C, G) is the part that the shared unknowns explain, None if it is too large to keep. For a compact
    problem it holds the products (B, C, c) with the stored columns instead, before they are made orthonormal. ``gram``
    (B, C, C) are the products epoch by epoch, ``input_gram`` their part in the rows of the inputs' priors.
    """

    whitened: Whitened
    places: dict[str, slice]
    columns: Array
    shared: Array | None
    gram: Array
    input_gram: Array

    def explained(self, index: Integers, during: slice = slice(None)) -> Array:
        """Return ``shared`` (B, n, G or c) for some pathways, at some epochs."""
        if self.shared is not None:
            return self.shared[during][:, index]
        return np.swapaxes(self.columns[during][:, :, index], 1, 2) @ self._basis[during]

    @property
    def is_compact(self) -> bool:
        """True if the problem is stored compactly."""
        return self.whitened.whole is None

    def explained_by_design(self, index: Integers, design: Array, during: slice) -> Array:
        """Return the part (G, P) of designs (B, n, P) over some pathways that the shared unknowns explain."""
        if self.is_compact:
            return self.whitened.onto_basis(
                self.whitened.compact.combined(self.explained(index, during), design, during)
            )
        size, (_, height, _) = design.shape[-1], self.columns.shape
        # The order of the products that needs fewer operations.
        if self.shared is None and height * size < len(index) * (height + size):
            moved = self.columns[during][:, :, index] @ design
            return np.asarray(self._basis[during].reshape(-1, self._basis.shape[-1]).T @ moved.reshape(-1, size))
        shared = self.explained(index, during)
        return np.asarray((design.reshape(-1, size).T @ shared.reshape(-1, shared.shape[-1])).T)

    @property
    def _basis(self) -> Array:
        """Rows (B, M + H, G) of the shared basis that belong to epochs."""
        epochs, height, _ = self.columns.shape
        return self.whitened.basis[: epochs * height].reshape(epochs, height, -1)

    def along(self, rows: Array) -> Array:
        """Return the parts (D, B, C) of residuals (D, N) along the pathways, in the precision of the residuals. Single
        precision is enough for draws, in half the time."""
        if rows.dtype == np.float64:
            columns, own = self.columns, np.stack([self.whitened.without_shared(row) for row in rows])
        else:
            columns, basis = self._rough
            own = rows - (rows @ basis) @ basis.T
        epochs, height, _ = columns.shape
        own = own[:, : epochs * height].reshape(len(rows), epochs, height)
        return np.asarray(np.matmul(own.transpose(1, 0, 2), columns).transpose(1, 0, 2))

    @cached_property
    def _rough(self) -> tuple[Array, Array]:
        return self.columns.astype(np.float32), self.whitened.rough_basis()

    def without_draws(self) -> None:
        """Free the arrays that only draws need."""
        self.__dict__.pop("_rough", None)

    def index(self, names: tuple[str, ...]) -> Integers:
        """Return the indices of the named pathways, in that order."""
        return np.concatenate([np.arange(self.places[name].start, self.places[name].stop) for name in names])

    def part(self, index: Integers) -> _Part:
        """Return the arrays of the pathways that an index selects."""
        key = index.tobytes()
        if key not in self._parts:
            self._parts[key] = _Part(*(self._products(gram, index) for gram in (self.gram, self.input_gram)))
        return self._parts[key]

    def _products(self, gram: Array, index: Integers) -> Array:
        """Return the rows and columns (B, n, n) of products that an index selects; a copy unless it is contiguous."""
        if len(index) and np.all(np.diff(index) == 1):
            return gram[:, index[0] : index[-1] + 1, index[0] : index[-1] + 1]
        return gram[np.ix_(np.arange(len(gram)), index, index)]

    @cached_property
    def _parts(self) -> dict[bytes, _Part]:
        return {}


def pathways_of(
    whitened: Whitened,
    measured: Observations,
    frames: Frames,
    motions: Mapping[str, Array],
    input_rows: slice,
) -> Pathways:
    """Return a fit's pathways from their motions (B, K, d, C_i) of the observations; the observations themselves come
    last.

    ``input_rows`` are the places of the inputs among an epoch's local unknowns.
    """
    wide = [whitened_columns(measured, frames, motion) for motion in motions.values()]
    each = measured.whitener @ frames.R[:, None]
    wide.append(_blocks(each))
    names = (*motions, OBSERVED)
    ends = np.cumsum([part.shape[-1] for part in wide])
    places = {n: slice(int(end) - w.shape[-1], int(end)) for n, w, end in zip(names, wide, ends, strict=True)}
    error_groups = np.concatenate(wide, -1)
    height = error_groups.shape[1]
    local = whitened.local_basis
    by_local = np.swapaxes(local[:, :height], 1, 2) @ error_groups
    columns = -local @ by_local
    columns[:, :height] += error_groups
    moved = error_groups[..., : places[OBSERVED].start]
    if whitened.whole is None:
        shared: Array | None = np.swapaxes(columns, 1, 2) @ whitened.own
    else:
        is_kept = error_groups.shape[0] * error_groups.shape[2] * whitened.whole.shape[1] <= _MOST_KEPT
        shared = _shared_products(whitened, moved, each) if is_kept else None
    gram = _gram(moved, each)
    gram -= np.swapaxes(by_local, 1, 2) @ by_local
    first = height + input_rows.start
    inputs = columns[:, first : first + input_rows.stop - input_rows.start]
    of_inputs = np.swapaxes(inputs, 1, 2) @ inputs if inputs.size else np.broadcast_to(0.0, gram.shape)
    return Pathways(whitened, places, columns, shared, gram, of_inputs)


def _shared_products(whitened: Whitened, moved: Array, each: Array) -> Array:
    """Return the products (B, C, G) of the shared basis with pathways.

    The basis is free of local unknowns, the pathways are not. They are motions ``moved`` (B, d K, m), then single
    observations ``each`` (B, K, d, d).
    """
    epochs, height, _ = moved.shape
    tall = whitened.local_basis.shape[1]
    basis = whitened.basis[: epochs * tall].reshape(epochs, tall, -1)[:, :height]
    return _by_pathways(moved, each, np.ascontiguousarray(basis))


def _by_pathways(moved: Array, each: Array, rows: Array) -> Array:
    """Return the products (B, C, n) of pathways with rows (B, d K, n)."""
    turned = np.swapaxes(each, 2, 3) @ rows.reshape(*each.shape[:3], -1)
    return np.concatenate([np.swapaxes(moved, 1, 2) @ rows, turned.reshape(rows.shape)], 1)


def _gram(moved: Array, each: Array) -> Array:
    """Return the products (B, C, C) of pathways with each other, local unknowns included."""
    epochs, height, count = moved.shape
    others = _by_pathways(moved, each, moved)
    gram = np.empty((epochs, count + height, count + height))
    gram[:, :, :count] = others
    gram[:, :count, count:] = np.swapaxes(others[:, count:], 1, 2)
    gram[:, count:, count:] = _blocks(np.swapaxes(each, 2, 3) @ each)
    return gram


def _blocks(blocks: Array) -> Array:
    """Return the matrices (B, d K, d K) with blocks (B, K, d, d) on their diagonals."""
    epochs, count, size, _ = blocks.shape
    full = np.zeros((epochs, count, size, count, size))
    each = np.arange(count)
    full[:, each, :, each] = blocks.transpose(1, 0, 2, 3)
    return full.reshape(epochs, size * count, size * count)


@dataclass(frozen=True)
class Signature:
    """A candidate's signature: independent directions, each a combination of its parameters.

    ``strengths`` (r,): signal-to-noise ratios of a plausible effect along them; ``loadings`` (P, r): their parameters;
    ``design`` (B * C, P): derivatives of the pathways at ``index`` by the parameters; ``explained`` (G, P): the part
    that the shared unknowns explain; ``input_share``: the share of the evidence that rests on the inputs.
    """

    index: Integers
    design: Array
    explained: Array
    gram: Array  # (P, P)
    strengths: Array
    loadings: Array
    input_share: float

    @property
    def rank(self) -> int:
        """Number of directions in which the campaign sees the candidate."""
        return len(self.strengths)

    @property
    def parameters(self) -> int:
        """Number of parameters P."""
        return len(self.gram)

    @property
    def unit_design(self) -> Array:
        """Design (B * C, r) whose scores have unit variance where there is no effect."""
        return self.design @ (self.loadings / self.strengths)

    def rows(self, pathways: Pathways) -> Array:
        """Return its directions as orthonormal rows (N, r) of the whitened problem, orthogonal to the nuisances."""
        epochs = len(pathways.columns)
        own = pathways.columns[:, :, self.index] @ self.unit_design.reshape(epochs, len(self.index), -1)
        full = np.zeros((len(pathways.whitened.rest), self.rank))
        full[: own.shape[0] * own.shape[1]] = own.reshape(-1, self.rank)
        return full - pathways.whitened.along_basis(self.explained @ (self.loadings / self.strengths))

    def share_on(self, pathways: Pathways, other: Signature) -> float:
        """Return the share of its squared changes that lies where another candidate acts too."""
        mine, theirs = self._moved_squares(pathways), other._moved_squares(pathways)
        shared = mine[theirs > _MOVED * theirs.max(initial=0.0)].sum()
        return float(shared / max(float(mine.sum()), 1e-300))

    def _moved_squares(self, pathways: Pathways) -> Array:
        """Return its squared change of each coordinate of the observations at every epoch, (B, d K)."""
        place = pathways.places[OBSERVED]
        rows = pathways.columns[:, : place.stop - place.start, self.index]
        return np.asarray(np.sum((rows @ self.design.reshape(len(rows), len(self.index), -1)) ** 2, -1))

    def fitted(self, along: Array) -> Array:
        """Return the parameters (P,), in plausible scales, that fit scores along the unit design (r,) best."""
        return np.asarray(self.loadings @ (along / self.strengths))


_UNSEEN = Signature(
    np.zeros(0, int), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), 0.0
)


@dataclass(frozen=True)
class _Acting:
    """Design (B, n, P) of a candidate over the pathways at ``index``, and the epochs during which it acts."""

    index: Integers
    design: Array
    during: slice

    @property
    def size(self) -> int:
        return int(self.design.shape[-1])


def signature(pathways: Pathways, designs: Mapping[str, Array]) -> Signature:
    """Return the signature of a candidate from its designs (B or 1, C_i, P) by pathway, per plausible scale."""
    return signatures_of(pathways, [designs])[0]


def signatures_of(pathways: Pathways, designs: Iterable[Mapping[str, Array]]) -> list[Signature]:
    """Return the signatures of candidates, each from its designs (B or 1, C_i, P) by pathway, per plausible scale."""
    acting = [_acting(pathways, own) for own in designs]
    alike: dict[bytes, list[tuple[int, _Acting]]] = {}
    for number, one in enumerate(acting):
        if one is not None:
            alike.setdefault(one.index.tobytes(), []).append((number, one))
    found = [_UNSEEN] * len(acting)
    for members in alike.values():
        for first in range(0, len(members), _AT_ONCE):
            chunk = members[first : first + _AT_ONCE]
            explained = _explained(pathways, [own for _, own in chunk])
            for (number, own), part in zip(chunk, explained, strict=True):
                found[number] = _signature(pathways, own, part)
    return found


def _acting(pathways: Pathways, designs: Mapping[str, Array]) -> _Acting | None:
    epochs = len(pathways.columns)
    names = tuple(name for name in pathways.places if name in designs)
    parts = [np.broadcast_to(designs[name], (epochs, *designs[name].shape[1:])) for name in names]
    if not parts:
        return None
    design = np.concatenate(parts, 1)
    acting = (design != 0.0).reshape(epochs, -1)  # whole rows reduce faster, and there are thousands of candidates
    of_pathway = acting.any(0).reshape(design.shape[1:]).any(1)
    return _Acting(pathways.index(names)[of_pathway], design[:, of_pathway], _extent(acting.any(1)))


def _explained(pathways: Pathways, alike: Sequence[_Acting]) -> list[Array]:
    """Return the part (G, P) of each candidate on the same pathways that the shared unknowns explain, by one product
    for all."""
    first = min((own.during.start for own in alike if own.during.stop), default=0)
    during = slice(first, max(own.during.stop for own in alike))
    wide = np.concatenate([own.design[during] for own in alike], -1)
    found = pathways.explained_by_design(alike[0].index, wide, during)
    return np.split(found, np.cumsum([own.size for own in alike])[:-1], 1)


def _signature(pathways: Pathways, acting: _Acting, explained: Array) -> Signature:
    part, own = pathways.part(acting.index), acting.design[acting.during]
    moved = part.gram[acting.during] @ own
    whole = own.reshape(-1, acting.size).T @ moved.reshape(-1, acting.size)
    gram = whole - explained.T @ explained
    values, vectors = np.linalg.eigh((gram + gram.T) / 2)
    kept = values > np.maximum(_INFORMATIVE**2, 1e-9 * np.trace(whole))
    share = float(np.sum(own * (part.input_gram[acting.during] @ own)) / max(np.trace(whole), 1e-300))
    return Signature(
        acting.index,
        acting.design.reshape(-1, acting.size),
        explained,
        gram,
        np.sqrt(values[kept]),
        vectors[:, kept],
        min(max(share, 0.0), 1.0),
    )


def _extent(acting: Array) -> slice:
    """Return the slice from the first to the last epoch at which a candidate acts; many act only from some epoch on."""
    epochs = np.flatnonzero(acting)
    return slice(epochs[0], epochs[-1] + 1) if len(epochs) else slice(0)


def joint(pathways: Pathways, first: Signature, second: Signature) -> tuple[Array, Array]:
    """Return strengths (r,) and loadings (P1 + P2, r) of two candidates together, after nuisances."""
    cross = _cross(pathways, first, second) - first.explained.T @ second.explained
    gram = np.block([[first.gram, cross], [cross.T, second.gram]])
    values, vectors = np.linalg.eigh(gram)
    kept = values > np.maximum(_INFORMATIVE**2, 1e-9 * np.trace(gram))
    return np.sqrt(values[kept]), vectors[:, kept]


def _cross(pathways: Pathways, first: Signature, second: Signature) -> Array:
    epochs = len(pathways.columns)
    grid = np.ix_(np.arange(epochs), first.index, second.index)
    left = first.design.reshape(epochs, -1, first.design.shape[-1])
    right = second.design.reshape(epochs, -1, second.design.shape[-1])
    return np.tensordot(left, pathways.gram[grid] @ right, axes=([0, 1], [0, 1]))


@dataclass(frozen=True)
class RotatedChannels:
    """Pathway of the observations of T channels along the axes of their groups' surveys.

    With patterns: of T sets of n channels that move together, along the q patterns of each (for a single channel its
    axes: n = 1, q = d). ``rotations`` (B, T, n d, q) convert these to the axes of the pathway; ``shared`` (B, T, q, G)
    is the part that the shared unknowns explain as in `Pathways`, ``gram`` (B, T, q, q) are their products.
    """

    channels: Integers  # (T, n)
    rotations: Array
    shared: Array
    gram: Array
    whitened: Whitened

    def explained(self, weights: Array) -> Array:
        """Return the part (W, T, q, G) of the channels that the shared unknowns explain, summed with weights (W, B)."""
        epochs, channels, size, _ = self.shared.shape
        if self.whitened.whole is not None:
            return (weights @ self.shared.reshape(epochs, -1)).reshape(len(weights), channels, size, -1)
        found = self.whitened.compact.weighted(self.shared.reshape(epochs, channels * size, -1), weights)
        return self.whitened.onto_basis(found.reshape(-1, found.shape[-1]).T).T.reshape(
            len(weights), channels, size, -1
        )

    def along(self, parts: Array) -> Array:
        """Return the parts (B, T, q, D) of residuals along these axes, from those along the pathway (D, B, C)."""
        (count, members), (height, _) = self.channels.shape, self.rotations.shape[2:]
        own = parts.reshape(*parts.shape[:2], -1, height // members)[:, :, self.channels]
        own = own.reshape(*parts.shape[:2], count, height)
        rotations = self.rotations.astype(parts.dtype, copy=False)  # single precision is enough for draws
        return np.asarray(np.einsum("dbtx,btxy->btyd", own, rotations, optimize=True))


def rotated_channels(
    pathways: Pathways, channels: Integers, rotations: Array, patterns: Array | None = None
) -> RotatedChannels:
    """Return the pathway of the observations of channels (T,), along axes given by rotations (B, K, d, d) of all
    channels.

    For sets of channels (T, n) that move together, along patterns (T, n, d, q) in these axes.
    """
    place = pathways.places[OBSERVED]
    epochs, size = len(rotations), rotations.shape[2]
    members = channels.reshape(len(channels), -1)
    own = rotations[:, members] if patterns is None else rotations[:, members] @ patterns
    height = members.shape[1] * size
    own = own.reshape(epochs, len(members), height, -1)
    back = np.swapaxes(own, -1, -2)
    rows = (members[..., None] * size + np.arange(size)).reshape(len(members), height)
    shared = pathways.explained(np.arange(place.start, place.stop))[:, rows]
    blocks = pathways.gram[:, place, place][:, rows[:, :, None], rows[:, None, :]]
    return RotatedChannels(members, own, back @ shared, back @ blocks @ own, pathways.whitened)


@dataclass(frozen=True)
class ChannelSignatures:
    """Signatures of T channels with S shapes of m columns each; ``gram`` (S, T, d m, d m) after nuisances.

    ``values`` (S, B, m) are the shapes over the epochs, per plausible scale.
    """

    rotated: RotatedChannels
    values: Array
    gram: Array
    usable: Mask  # (S, T) True where the channel was seen often enough

    @property
    def parameters(self) -> int:
        """Number of parameters of each candidate."""
        return int(self.gram.shape[-1])

    @cached_property
    def seen(self) -> Mask:
        """True for candidates (S, T) that the campaign sees in all directions."""
        return np.asarray(np.linalg.eigvalsh(self.gram)[..., 0] > _INFORMATIVE**2) & self.usable

    @cached_property
    def inverse(self) -> Array:
        """Inverse of the gram (S, T, d m, d m); zero where a candidate is not seen."""
        safe = np.where(self.seen[..., None, None], self.gram, np.eye(self.parameters))
        return np.linalg.inv(safe) * self.seen[..., None, None]

    def scores(self, along: Array) -> Array:
        """Return the scores (S, T, d m, D) of residuals, from their parts (B, T, d, D) along the observations' axes."""
        epochs, channels, size, draws = along.shape
        shapes = self.values.transpose(0, 2, 1).reshape(-1, epochs).astype(along.dtype, copy=False)
        found = (shapes @ along.reshape(epochs, -1)).reshape(len(self.values), -1, channels, size, draws)
        return found.transpose(0, 2, 1, 3, 4).reshape(len(self.values), channels, -1, draws)

    def squares(self, along: Array) -> Array:
        """Return the reduction of the sum of squares by each candidate, (D, S, T); ``along`` as in `scores`."""
        scores = self.scores(along)
        inverse = self.inverse.astype(scores.dtype, copy=False)
        return np.asarray(np.sum(scores * (inverse @ scores), 2).transpose(2, 0, 1))


def channel_signatures(rotated: RotatedChannels, values: Array, usable: Mask) -> ChannelSignatures:
    """Return the signatures of observations with shapes values (S, B, m).

    ``usable`` (S, T) marks channels that were seen often enough for a shape.
    """
    epochs, channels, size = rotated.shared.shape[:3]
    shapes, count = values.shape[0], values.shape[2]
    explained = rotated.explained(values.transpose(0, 2, 1).reshape(-1, epochs))
    explained = explained.reshape(shapes, count, channels, size, -1).swapaxes(1, 2)
    explained = explained.reshape(shapes, channels, size * count, -1)
    pairs = values[..., :, None] * values[..., None, :]
    whole = pairs.transpose(0, 2, 3, 1).reshape(-1, epochs) @ rotated.gram.reshape(epochs, -1)
    whole = whole.reshape(shapes, count, count, channels, size, size).transpose(0, 3, 1, 4, 2, 5)
    whole = whole.reshape(shapes, channels, size * count, size * count)
    return ChannelSignatures(rotated, values, whole - explained @ np.swapaxes(explained, -1, -2), usable)
