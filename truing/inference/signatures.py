"""Signatures of candidate effects: their derivatives in the rows of a whitened problem, orthogonal to the nuisances.

A candidate acts through a few pathways (an input of each part, a shift of a part, an observation). The pathways are
projected once, and a candidate is a design over them, a thin matrix per epoch. Each of thousands of candidates then
costs one small matrix, and a search over simulated residuals one product.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from truing.inference.arrays import Array, Integers, grouped, index_or_slice
from truing.inference.linear_problem import Whitened
from truing.inference.model import OBSERVED, PartialDesign
from truing.inference.observations import Frames, Observations, whitened_columns

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Directions in which a plausible effect stays below this many sigma are not tested.
INFORMATIVE = 0.3
# An effect acts where its squared change is above this share of its largest one.
_MOVED = 1e-3
# Values of the designs of candidates that are projected by one product.
_AT_ONCE = 2**18
# Candidates are no batch if the epochs of all are this many times those during which each acts.
_MOSTLY_IDLE = 3
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

    @property
    def has_inputs(self) -> bool:
        """True if any evidence rests on inputs."""
        return bool(self.input_gram.strides[0])

    def explained(self, index: Integers, during: slice = slice(None)) -> Array:
        """Return ``shared`` (B, n, G or c) for some pathways, at some epochs."""
        if self.shared is not None:
            return self.shared[during][:, index_or_slice(index)]
        return np.swapaxes(self.columns[during][:, :, index], 1, 2) @ self._basis[during]

    @property
    def is_compact(self) -> bool:
        """True if the problem is stored compactly."""
        return self.whitened.whole is None

    def explained_by_design(self, index: Integers, design: Array, during: slice) -> Array:
        """Return the part (G, P) of designs (B, n, P) over some pathways that the shared unknowns explain."""
        if self.is_compact:
            products, few = self.explained(index, during), self._few_of(index)
            few = (
                few
                if len(products) == len(self.columns)
                else few[:, during.start * len(index) : during.stop * len(index)]
            )
            return self.whitened.onto_basis(self.whitened.compact.combined(products, design, during, few))
        size, (_, height, _) = design.shape[-1], self.columns.shape
        # The order of the products that needs fewer operations.
        if self.shared is None and height * size < len(index) * (height + size):
            moved = self.columns[during][:, :, index] @ design
            return np.asarray(self._basis[during].reshape(-1, self._basis.shape[-1]).T @ moved.reshape(-1, size))
        shared = self.explained(index, during)
        return np.asarray((design.reshape(-1, size).T @ shared.reshape(-1, shared.shape[-1])).T)

    def _few_of(self, index: Integers) -> csr_array:
        """Return the products of some pathways with columns that act in few epochs, as `SharedRows.few_of` does."""
        key = index.tobytes()
        if key not in self._known_few:
            self._known_few[key] = self.whitened.compact.few_of(self.explained(index))
        return self._known_few[key]

    @cached_property
    def _known_few(self) -> dict[bytes, csr_array]:
        return {}

    @property
    def _basis(self) -> Array:
        """Rows (B, M + H, G) of the shared basis that belong to epochs."""
        epochs, height, _ = self.columns.shape
        return self.whitened.basis[: epochs * height].reshape(epochs, height, -1)

    def along(self, rows: Array) -> Array:
        """Return the parts (D, B, C) of residuals (D, N) along the pathways, in the precision of the residuals. Single
        precision is enough for draws, in half the time."""
        if rows.dtype == np.float64:
            columns, residuals = self.columns, np.stack([self.whitened.without_shared(row) for row in rows])
        else:
            columns = self._rough
            residuals = self.whitened.without_shared_roughly(rows)
        epochs, height, _ = columns.shape
        residuals = residuals[:, : epochs * height].reshape(len(rows), epochs, height)
        parts = np.matmul(residuals.transpose(1, 0, 2), columns).transpose(1, 0, 2)
        return np.ascontiguousarray(parts)  # else every bank of candidates would copy them

    @cached_property
    def residual(self) -> Array:
        """Parts (B, C) of the fit's residual along the pathways."""
        return np.asarray(self.along(self.whitened.rest[None])[0])

    @cached_property
    def _rough(self) -> Array:
        return self.columns.astype(np.float32)

    def prepare_draws(self) -> None:
        """Form the arrays that only draws need, before several searches use them at once."""
        _ = self._rough
        self.whitened.prepare_draws()

    def without_draws(self) -> None:
        """Free the arrays that only draws need."""
        self.__dict__.pop("_rough", None)
        self.whitened.without_draws()

    def index(self, names: tuple[str, ...]) -> Integers:
        """Return the indices of the named pathways, in that order."""
        return np.concatenate([np.arange(self.places[name].start, self.places[name].stop) for name in names])

    def combined(self, motions: Sequence[Mapping[str, Array]]) -> Pathways:
        """Return new pathways named by their number. Each moves some of these together, by the weights (C_i,) of each
        pathway."""
        names = tuple(name for name in self.places if any(name in own for own in motions))
        sizes = {name: self.places[name].stop - self.places[name].start for name in names}
        weights = np.stack([_concatenated(motion, sizes) for motion in motions], 1)
        moved = weights.any(1)
        index, weights = self.index(names)[moved], weights[moved]
        part = self.part(index)
        of_inputs = np.broadcast_to(0.0, (len(self.gram), len(motions), len(motions)))
        if self.has_inputs:
            of_inputs = weights.T @ (part.input_gram @ weights)
        return Pathways(
            self.whitened,
            {str(number): slice(number, number + 1) for number in range(len(motions))},
            self.columns[:, :, index] @ weights,
            None if self.shared is None else weights.T @ self.shared[:, index],
            weights.T @ (part.gram @ weights),
            of_inputs,
        )

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
        return gram[:, index[:, None], index]

    @cached_property
    def _parts(self) -> dict[bytes, _Part]:
        return {}


def _concatenated(parts: Mapping[str, Array], sizes: Mapping[str, int]) -> Array:
    """Return parts (C_i,) side by side, in the order of their sizes; zero for those that are missing."""
    return np.concatenate([parts.get(name, np.zeros(size)) for name, size in sizes.items()])


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
        own_squares, other_squares = self._moved_squares(pathways), other._moved_squares(pathways)
        shared = own_squares[other_squares > _MOVED * other_squares.max(initial=0.0)].sum()
        return float(shared / max(float(own_squares.sum()), 1e-300))

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

    @property
    def extent(self) -> tuple[int, int]:
        return self.during.start, self.during.stop


def signature(pathways: Pathways, designs: Mapping[str, Array]) -> Signature:
    """Return the signature of a candidate from its designs (B or 1, C_i, P) by pathway, per plausible scale."""
    return signatures_of(pathways, [designs])[0]


def signatures_of(pathways: Pathways, designs: Iterable[Mapping[str, Array | PartialDesign]]) -> list[Signature]:
    """Return the signatures of candidates, each from its designs (B or 1, C_i, P) by pathway, per plausible scale."""
    acting = _acting(len(pathways.columns), [_side_by_side(pathways, design) for design in designs])
    signatures = [_UNSEEN] * len(acting)
    seen = [number for number, candidate in enumerate(acting) if candidate.size]
    for places in grouped(acting[number].index.tobytes() for number in seen).values():
        members = sorted((seen[place] for place in places), key=lambda number: acting[number].extent)
        for numbers in _chunks(members, sum(acting[number].design.size for number in members)):
            candidates = [acting[number] for number in numbers]
            made = _signatures(pathways, candidates, _explained(pathways, candidates))
            for number, signed in zip(numbers, made, strict=True):
                signatures[number] = signed
    return signatures


def _chunks(numbers: Sequence[int], size: int) -> Iterator[Sequence[int]]:
    """Yield parts of the numbers of candidates, whose designs together have a limited number of values."""
    at_once = max(_AT_ONCE * len(numbers) // max(size, 1), 1)
    return (numbers[first : first + at_once] for first in range(0, len(numbers), at_once))


def _side_by_side(pathways: Pathways, designs: Mapping[str, Array | PartialDesign]) -> tuple[Integers, Array]:
    """Return the pathways (n,) that a candidate may move, and its design (B, n, P) over these."""
    epochs = len(pathways.columns)
    places, parts = [], []
    for name, place in pathways.places.items():
        if (partial := designs.get(name)) is not None:
            if not isinstance(partial, PartialDesign):
                partial = PartialDesign(np.arange(place.stop - place.start), partial)
            places.append(place.start + partial.places)
            values = partial.values
            parts.append(values if len(values) == epochs else np.broadcast_to(values, (epochs, *values.shape[1:])))
    if not parts:
        return np.zeros(0, int), np.zeros((epochs, 0, 0))
    return (places[0], parts[0]) if len(parts) == 1 else (np.concatenate(places), np.concatenate(parts, 1))


def _acting(epochs: int, designed: Sequence[tuple[Integers, Array]]) -> list[_Acting]:
    """Return the pathways and epochs in which each candidate acts, from its pathways (n,) and design (B, n, P).

    Candidates with designs of the same shape are evaluated together.
    """
    acting: dict[int, _Acting] = {}
    for shape, members in grouped(design.shape for _, design in designed).items():
        for numbers in _chunks(members, len(members) * math.prod(shape)):
            moved = np.stack([designed[number][1] for number in numbers]) != 0.0
            moved = moved.reshape(len(numbers), epochs, -1)  # whole rows reduce faster
            of_pathway = moved.any(1).reshape(len(numbers), *shape[1:]).any(2)
            during, whole = moved.any(2), of_pathway.all(1)
            first, last = during.argmax(1), epochs - during[:, ::-1].argmax(1)
            last[~during.any(1)] = 0
            for place, number in enumerate(numbers):
                index, design = designed[number]
                if not whole[place]:
                    index, design = index[of_pathway[place]], design[:, of_pathway[place]]
                acting[number] = _Acting(index, design, slice(int(first[place]), int(last[place])))
    return [acting[number] for number in range(len(designed))]


def _explained(pathways: Pathways, alike: Sequence[_Acting]) -> list[Array]:
    """Return the part (G, P) of each candidate on the same pathways that the shared unknowns explain, by one product
    for all."""
    during = _union(alike)
    wide = np.concatenate([candidate.design[during] for candidate in alike], -1)
    explained = pathways.explained_by_design(alike[0].index, wide, during)
    return np.split(explained, np.cumsum([candidate.size for candidate in alike])[:-1], 1)


def _signatures(pathways: Pathways, alike: Sequence[_Acting], explained: Sequence[Array]) -> list[Signature]:
    """Return the signatures of candidates on the same pathways, of which each explains a part (G, P) with the shared
    unknowns. Those with as many parameters are one batch; if most of them act in few epochs, those that act in the
    same ones."""
    signatures: dict[int, Signature] = {}
    for places in grouped(candidate.size for candidate in alike).values():
        extents = [alike[place].extent for place in places]
        during = _union([alike[place] for place in places])
        idle = (during.stop - during.start) * len(places) > _MOSTLY_IDLE * sum(stop - start for start, stop in extents)
        for batch in grouped(extents).values() if idle else (range(len(places)),):
            members = [places[n] for n in batch]
            made = _batch(pathways, [alike[n] for n in members], np.stack([explained[n] for n in members]))
            signatures |= zip(members, made, strict=True)
    return [signatures[place] for place in range(len(alike))]


def _union(alike: Sequence[_Acting]) -> slice:
    """Return the epochs during which any of some candidates acts."""
    first = min((candidate.during.start for candidate in alike if candidate.during.stop), default=0)
    return slice(first, max(candidate.during.stop for candidate in alike))


def _batch(pathways: Pathways, alike: Sequence[_Acting], explained: Array) -> list[Signature]:
    """Return the signatures of k candidates with P parameters on the same pathways; ``explained`` (k, G, P)."""
    during, part, index = _union(alike), pathways.part(alike[0].index), alike[0].index
    designs = np.stack([candidate.design[during] for candidate in alike], 2)  # (b, n, k, P)
    gram_before = _of_each(designs, part.gram[during])
    gram = gram_before - np.swapaxes(explained, 1, 2) @ explained
    values, vectors = np.linalg.eigh((gram + np.swapaxes(gram, 1, 2)) / 2)
    traces = np.trace(gram_before, axis1=1, axis2=2)
    informative = values > np.maximum(INFORMATIVE**2, 1e-9 * traces)[:, None]
    strengths = np.sqrt(np.maximum(values, 0.0))
    shares = np.zeros(len(alike))
    if pathways.has_inputs:
        of_inputs = np.trace(_of_each(designs, part.input_gram[during]), axis1=1, axis2=2)
        shares = np.clip(of_inputs / np.maximum(traces, 1e-300), 0.0, 1.0)
    return [
        Signature(
            index,
            candidate.design.reshape(-1, candidate.size),
            explained[k],
            gram[k],
            strengths[k, informative[k]],
            vectors[k][:, informative[k]],
            float(shares[k]),
        )
        for k, candidate in enumerate(alike)
    ]


def _of_each(designs: Array, gram: Array) -> Array:
    """Return the products (k, P, P) of designs (b, n, k, P) with themselves, by products (b, n, n) of pathways."""
    epochs, height, count, size = designs.shape
    moved = gram @ designs.reshape(epochs, height, count * size)
    left = designs.reshape(-1, count, size).transpose(1, 2, 0)
    return np.asarray(left @ moved.reshape(-1, count, size).transpose(1, 0, 2))


def joint(pathways: Pathways, first: Signature, second: Signature) -> tuple[Array, Array]:
    """Return strengths (r,) and loadings (P1 + P2, r) of two candidates together, after nuisances."""
    cross = _cross(pathways, first, second) - first.explained.T @ second.explained
    gram = np.block([[first.gram, cross], [cross.T, second.gram]])
    values, vectors = np.linalg.eigh(gram)
    informative = values > np.maximum(INFORMATIVE**2, 1e-9 * np.trace(gram))
    return np.sqrt(values[informative]), vectors[:, informative]


def _cross(pathways: Pathways, first: Signature, second: Signature) -> Array:
    epochs = len(pathways.columns)
    left = first.design.reshape(epochs, -1, first.design.shape[-1])
    right = second.design.reshape(epochs, -1, second.design.shape[-1])
    return np.tensordot(left, pathways.gram[:, first.index[:, None], second.index] @ right, axes=([0, 1], [0, 1]))
