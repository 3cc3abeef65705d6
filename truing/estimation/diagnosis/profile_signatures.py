"""Signatures of one point at a time: every target with every shape over the poses (an onset, a smooth dependence).

There are as many as targets times shapes, so they are scored together, each by a matrix of three rows per column of its
shape, and none is built by itself before it is the best.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truing.estimation.diagnosis.signatures import POINTS, Channels

# A direction of a target that noise alone moves by more than three times a plausible size carries no test.
_INFORMATIVE = 0.3


@dataclass(frozen=True)
class ProfileSignatures:
    """Signatures of T targets with S shapes of m columns each; ``gram`` (S, T, 3m, 3m) after nuisances.

    ``values`` (S, B, m) are the shapes over the poses, per plausible scale; ``turned`` (B, T, 3, 3) brings a target's
    body axes to the channel of points.
    """

    values: NDArray
    targets: NDArray  # (T,)
    turned: NDArray
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
        """Return the inverse of the gram (S, T, 3m, 3m); zero where a candidate is not seen."""
        safe = np.where(self.seen[..., None, None], self.gram, np.eye(self.parameters))
        return np.linalg.inv(safe) * self.seen[..., None, None]

    def scores(self, along: NDArray) -> NDArray:
        """Return the scores (S, T, 3m, D) of residuals given by their parts (D, B, C) along the channel of points."""
        draws, poses, _ = along.shape
        own = along.reshape(draws, poses, -1, 3)[:, :, self.targets]
        turned = np.einsum("dbtx,btxy->btyd", own, self.turned, optimize=True)
        shapes = self.values.transpose(0, 2, 1).reshape(-1, poses)
        found = (shapes @ turned.reshape(poses, -1)).reshape(len(self.values), -1, *turned.shape[1:])
        return found.transpose(0, 2, 1, 3, 4).reshape(len(self.values), len(self.targets), -1, draws)

    def squares(self, along: NDArray) -> NDArray:
        """Return by how much each candidate lowers the sum of squares, (D, S, T)."""
        scores = self.scores(along)
        return np.asarray(np.sum(scores * (self.inverse @ scores), 2).transpose(2, 0, 1))


def profile_signatures(
    channels: Channels, values: NDArray, targets: NDArray, turns: NDArray, usable: NDArray
) -> ProfileSignatures:
    """Return the signatures of targets (T,) with shapes values (S, B, m), whose axes turns (B, K, 3, 3) say.

    ``usable`` (S, T) tells which targets were seen often enough for which shapes.
    """
    place = channels.places[POINTS]
    poses, own_turns = len(turns), turns[:, targets]
    shared = channels.shared[:, :, place].reshape(poses, channels.shared.shape[1], -1, 3)[:, :, targets]
    shared = np.einsum("bgtx,btxy->bgty", shared, own_turns, optimize=True)
    size = place.stop - place.start
    blocks = channels.gram[:, place, place].reshape(poses, size // 3, 3, size // 3, 3)[:, targets, :, targets]
    own = np.einsum("btxi,tbxy,btyj->btij", own_turns, blocks, own_turns, optimize=True)
    shapes, count = values.shape[0], values.shape[2]
    explained = np.tensordot(values.transpose(0, 2, 1), shared, axes=(2, 0))  # (S, m, G, T, 3)
    explained = explained.transpose(0, 3, 1, 4, 2).reshape(shapes, len(targets), 3 * count, -1)
    pairs = values[..., :, None] * values[..., None, :]
    whole = np.tensordot(pairs.transpose(0, 2, 3, 1), own, axes=(3, 0))  # (S, m, m, T, 3, 3)
    whole = whole.transpose(0, 3, 1, 4, 2, 5).reshape(shapes, len(targets), 3 * count, 3 * count)
    return ProfileSignatures(values, targets, own_turns, whole - explained @ np.swapaxes(explained, -1, -2), usable)
