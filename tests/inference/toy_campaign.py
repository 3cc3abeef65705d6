"""A synthetic whitened problem of poses, points, readings and shared unknowns, with random columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truing.inference.channel_signatures import channel_signatures, rotated_channels
from truing.inference.linear_problem import Whitened, whiten
from truing.inference.linearised_model import LinearisedModel
from truing.inference.noise import components
from truing.inference.observations import Frames, Observations
from truing.inference.search import CauseCandidate, ChannelFamily, Search
from truing.inference.signatures import Pathways, pathways_of, signature

POSES, POINTS, SHARED, DRIVES = 24, 6, 5, 3
FRAME = 6  # unknowns of each pose before its readings
READINGS = slice(FRAME, FRAME + DRIVES)
MEASURED = Observations(
    np.zeros((POSES, POINTS, 3)), np.tile(np.eye(3), (POSES, POINTS, 1, 1)), np.ones((POSES, POINTS), bool)
)
FRAMES = Frames(np.tile(np.eye(3), (POSES, 1, 1)), np.zeros((POSES, 3)))


def template() -> LinearisedModel:
    rng = np.random.default_rng(0)
    rows, local = 3 * POINTS, FRAME + DRIVES
    known = np.arange(local) >= FRAME
    return LinearisedModel(
        np.zeros((POSES, rows)),
        rng.normal(size=(POSES, rows, local)) * np.where(known, 1.0, 20.0),
        rng.normal(size=(POSES, rows, SHARED)),
        np.zeros((POSES, local)),
        np.zeros(SHARED),
        np.zeros(0),
        np.zeros((0, SHARED)),
        np.ones((POSES, rows), bool),
        known,
        np.ones(SHARED, bool),
    )


TEMPLATE = template()


def measured(
    rng: np.random.Generator,
    effect: NDArray | float = 0.0,
    heavy: bool = False,
    points: float = 1.0,
    readings: float = 1.0,
) -> Whitened:
    """Residuals with noise, all unknown parts, and an effect on the rows of points."""
    rows = TEMPLATE.residual.shape
    noise = points * (rng.standard_t(5, rows) / np.sqrt(5 / 3) if heavy else rng.normal(size=rows))
    local = rng.normal(size=TEMPLATE.local_value.shape)
    local[:, READINGS] *= readings
    unknown = TEMPLATE.by_shared @ rng.normal(size=SHARED) + np.einsum("bmh,bh->bm", TEMPLATE.by_local, local)
    return whiten(replace(TEMPLATE, residual=unknown + noise + effect))


def channels(whitened: Whitened) -> Pathways:
    """One channel, ``drive``, that acts as the readings do, and the points."""
    motion = TEMPLATE.by_local[..., READINGS].reshape(POSES, POINTS, 3, DRIVES)
    return pathways_of(whitened, MEASURED, FRAMES, {"drive": motion}, READINGS)


def gain() -> dict[str, NDArray]:
    """A candidate with one parameter for each drive: in proportion to what was asked of it."""
    asked = np.random.default_rng(1).uniform(-1, 1, (POSES, DRIVES))
    return {"drive": asked[..., None] * np.eye(DRIVES)}


def onsets() -> NDArray:
    """Steps (S, B, 1) from the fourth pose on to the fourth from the end."""
    starts = np.arange(3, POSES - 2)
    return (np.arange(POSES) >= starts[:, None]).astype(float)[..., None]


def search(whitened: Whitened, draws: int, rng: np.random.Generator) -> Search:
    """A search over the gain of each and of all drives, and over targets that were moved."""
    own, design = channels(whitened), gain()["drive"]
    one = [
        CauseCandidate(_Cause(f"one {d}"), "gain", signature(own, {"drive": design[..., d : d + 1]}), 0.2)
        for d in (0, 1, 2)
    ]
    whole = CauseCandidate(_Cause("all"), "gain", signature(own, gain()), 0.4)
    shapes = onsets()
    usable = np.ones((len(shapes), POINTS), bool)
    turns = np.tile(np.eye(3), (POSES, POINTS, 1, 1))
    moved = channel_signatures(rotated_channels(own, np.arange(POINTS), turns), shapes, usable)
    noise = components(whitened, 3 * POINTS, READINGS)
    shares = {"gain": 1.0, "moved": 1.0}
    return Search(own, noise, [*one, whole], [ChannelFamily(None, "moved", moved)], shares, draws, rng)


class _Cause:
    """The part of a cause that the search reads: a name."""

    def __init__(self, key: str) -> None:
        self.key = key
