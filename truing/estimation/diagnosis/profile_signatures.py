"""Signatures of one point at a time: every target with every shape over the poses (an onset, a smooth dependence).

There are as many as targets times shapes, so they are scored together, each by a matrix of d rows per column of its
shape (d: coordinates of a point), and none is built by itself before it is the best. A few points that hold together
count as one, with as many rows as they have ways to move.
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
