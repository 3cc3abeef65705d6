"""Signatures of one point at a time: every target with every shape over the poses (an onset, a smooth dependence).

There are as many as targets times shapes, so they are scored together, each by a matrix of d rows per column of its
shape (d: coordinates of a point), and none is built by itself before it is the best.
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
class TurnedPoints:
    """The channel of points of T targets, along the axes of their bodies' surveys.

    ``turns`` (B, T, d, d) bring these axes to those of the channel, ``shared`` (B, T, d, G) is what of the channel the
    shared unknowns explain, ``gram`` (B, T, d, d) are each point's products.
    """

    targets: NDArray  # (T,)
    turns: NDArray
    shared: NDArray
    gram: NDArray

    def along(self, parts: NDArray) -> NDArray:
        """Return the parts (B, T, d, D) of residuals along these axes, from those along the channel (D, B, C)."""
        own = parts.reshape(*parts.shape[:2], -1, self.turns.shape[-1])[:, :, self.targets]
        return np.asarray(np.einsum("dbtx,btxy->btyd", own, self.turns, optimize=True))


def turned_points(channels: Channels, targets: NDArray, turns: NDArray) -> TurnedPoints:
    """Return the channel of points of targets (T,) along the axes that turns (B, K, d, d) of all targets say."""
    place = channels.places[POINTS]
    poses, count, size = turns.shape[:3]
    own = turns[:, targets]
    back = np.swapaxes(own, -1, -2)
    shared = np.swapaxes(channels.shared[:, :, place], 1, 2).reshape(poses, count, size, -1)[:, targets]
    blocks = channels.gram[:, place, place].reshape(poses, count, size, count, size)[:, targets, :, targets]
    return TurnedPoints(targets, own, back @ shared, back @ blocks.transpose(1, 0, 2, 3) @ own)


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
