"""Signatures of candidates over single channels: many shapes over the epochs at once, for observations of channels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from truing.inference.arrays import Array, Integers, Mask
from truing.inference.linear_problem import Whitened
from truing.inference.model import OBSERVED
from truing.inference.signatures import INFORMATIVE, Pathways

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Shapes are multiplied as a sparse matrix if fewer than this share of their values is not zero.
_SPARSE = 0.05
# Most values of the parts that shared unknowns explain at a time.
_MOST_AT_ONCE = 2**19
# Epochs in which a channel was not seen are left out of products, unless more than this share of all was seen.
_MOSTLY_OBSERVED = 0.9


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

    def explained(self, weights: Array, chosen: slice) -> Array:
        """Return the part (W, t, q, G) of some channels that the shared unknowns explain, by weights (W, B)."""
        shared = self.shared[:, chosen]
        epochs, channels, size, _ = shared.shape
        if self.whitened.whole is not None:
            return (weights @ shared.reshape(epochs, -1)).reshape(len(weights), channels, size, -1)
        few = self._products_in_few[chosen.start * size : chosen.stop * size]
        weighted = self.whitened.compact.weighted(shared.reshape(epochs, channels * size, -1), weights, few)
        return self.whitened.onto_basis(weighted.reshape(-1, weighted.shape[-1]).T).T.reshape(
            len(weights), channels, size, -1
        )

    @cached_property
    def _products_in_few(self) -> list[csr_array]:
        """Products with the columns that act in few epochs (`SharedRows.few_of`), one for each of the T q axes.

        Only for compact problems; signatures of all families share them.
        """
        compact = self.whitened.compact
        by_channel = self.shared.reshape(len(self.shared), -1, self.shared.shape[-1])
        return [compact.few_of(by_channel[:, n : n + 1]) for n in range(by_channel.shape[1])]

    @property
    def unknowns(self) -> int:
        """Number of shared unknowns G."""
        return len(self.whitened.problem.shared_value)

    @cached_property
    def observed_together(self) -> list[tuple[Integers, Integers]]:
        """Groups of channels that were seen at the same epochs, each with these epochs."""
        is_observed = np.trace(self.gram, axis1=2, axis2=3) > 0.0
        if is_observed.mean() > _MOSTLY_OBSERVED:  # then a single product is faster
            return [(np.arange(is_observed.shape[1]), np.arange(len(is_observed)))]
        patterns, number = np.unique(is_observed, axis=1, return_inverse=True)
        return [(np.flatnonzero(number.ravel() == n), np.flatnonzero(is_seen)) for n, is_seen in enumerate(patterns.T)]

    def along(self, parts: Array) -> Array:
        """Return the parts (B, T, q, D) of residuals along these axes, from those along the pathway (D, B, C)."""
        (count, members), (height, _) = self.channels.shape, self.rotations.shape[2:]
        of_channels = parts.reshape(*parts.shape[:2], -1, height // members)[:, :, self.channels]
        of_channels = of_channels.reshape(*parts.shape[:2], count, height)
        rotations = self.rotations.astype(parts.dtype, copy=False)  # single precision is enough for draws
        if rotations.shape[2:] == (1, 1):
            return np.multiply(of_channels.transpose(1, 2, 3, 0), rotations, order="C")
        return np.asarray(np.einsum("dbtx,btxy->btyd", of_channels, rotations, optimize=True))


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
    axes = rotations[:, members] if patterns is None else rotations[:, members] @ patterns
    height = members.shape[1] * size
    axes = axes.reshape(epochs, len(members), height, -1)
    back = np.swapaxes(axes, -1, -2)
    rows = (members[..., None] * size + np.arange(size)).reshape(len(members), height)
    shared = pathways.explained(np.arange(place.start, place.stop))[:, rows]
    blocks = pathways.gram[:, place, place][:, rows[:, :, None], rows[:, None, :]]
    return RotatedChannels(members, axes, back @ shared, back @ blocks @ axes, pathways.whitened)


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
    def is_observed(self) -> Mask:
        """True for candidates (S, T) that the campaign sees in all directions."""
        return np.asarray(np.linalg.eigvalsh(self.gram)[..., 0] > INFORMATIVE**2) & self.usable

    @cached_property
    def inverse(self) -> Array:
        """Inverse of the gram (S, T, d m, d m); zero where a candidate is not seen."""
        safe = np.where(self.is_observed[..., None, None], self.gram, np.eye(self.parameters))
        return np.linalg.inv(safe) * self.is_observed[..., None, None]

    def scores(self, along: Array) -> Array:
        """Return the scores (S, T, d m, D) of residuals, from their parts (B, T, d, D) along the observations' axes."""
        epochs, channels, size, draws = along.shape
        if self._is_sparse:
            sums = self._sparse_shapes.astype(along.dtype, copy=False) @ along.reshape(epochs, -1)
        else:
            shapes = self._shapes.astype(along.dtype, copy=False)
            sums = np.empty((len(shapes), channels, size, draws), along.dtype)
            for observed_channels, during in self.rotated.observed_together:
                part = along[np.ix_(during, observed_channels)]
                shaped = shapes[:, during] @ part.reshape(len(part), len(observed_channels) * size * draws)
                sums[:, observed_channels] = shaped.reshape(len(shapes), len(observed_channels), size, draws)
        sums = sums.reshape(len(self.values), -1, channels, size, draws)
        return np.asarray(sums.transpose(0, 2, 1, 3, 4).reshape(len(self.values), channels, -1, draws))

    @cached_property
    def _shapes(self) -> Array:
        """The shapes as rows (S m, B)."""
        return self.values.transpose(0, 2, 1).reshape(-1, self.values.shape[1])

    @cached_property
    def _is_sparse(self) -> bool:
        return bool(np.count_nonzero(self._shapes) < _SPARSE * self._shapes.size)

    @cached_property
    def _sparse_shapes(self) -> csr_array:
        from scipy.sparse import csr_array

        return csr_array(self._shapes)

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
    weights = values.transpose(0, 2, 1).reshape(-1, epochs)
    pairs = values[..., :, None] * values[..., None, :]
    gram = pairs.transpose(0, 2, 3, 1).reshape(-1, epochs) @ rotated.gram.reshape(epochs, -1)
    gram = gram.reshape(shapes, count, count, channels, size, size).transpose(0, 3, 1, 4, 2, 5)
    gram = gram.reshape(shapes, channels, size * count, size * count)
    at_once = max(1, _MOST_AT_ONCE // (len(weights) * size * rotated.unknowns))
    for first in range(0, channels, at_once):
        chosen = slice(first, first + at_once)
        explained = rotated.explained(weights, chosen).reshape(shapes, count, -1, size, rotated.unknowns)
        explained = explained.swapaxes(1, 2).reshape(shapes, -1, size * count, rotated.unknowns)
        gram[:, chosen] -= explained @ np.swapaxes(explained, -1, -2)
    return ChannelSignatures(rotated, values, gram, usable)
