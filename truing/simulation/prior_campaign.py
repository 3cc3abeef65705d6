"""What a prior campaign of the same machine or sensor has found, as rows of whitened knowledge for the next one.

A prior model holds what was known before it (tolerances) and what its campaign has told. Only the latter is handed on,
beside the tolerances of the next campaign: these then enter once.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import CauseT

_TOLD = 1e-9  # information below this share of the largest, or of what was known before, says nothing


class PartitionedModel(Protocol):
    """A model whose shared unknowns (G,) stand in named parts of one vector."""

    @property
    def layout(self) -> dict[str, slice]:
        """Return where each part stands."""

    @property
    def shared_size(self) -> int:
        """Return the number G of shared unknowns."""


@dataclass(frozen=True)
class SharedUnknowns:
    """One part of the unknowns that both campaigns have: its name in the layout, and the scale (n,) of each number."""

    name: str
    scale: NDArray


@dataclass(frozen=True)
class CampaignPrior(Generic[CauseT]):
    """What a prior campaign found of n numbers that the next one has too, counted from the latter's nominal, SI.

    ``causes`` are its persistent effects. mean (n,) and covariance (n, n): where it left the numbers; frames (n, n):
    what another survey adds to that; shared (n, n): the information in it that the next campaign has too (tolerances,
    and the survey where that is the same); information (n, n): what is new to the next campaign, centred at middle
    (n,), where that alone would have put the numbers: what is shared drew the estimate away from there, and comes in
    again with the next campaign. In units of the parts' scales.
    """

    causes: tuple[CauseT, ...]
    parts: tuple[SharedUnknowns, ...]
    mean: NDArray
    covariance: NDArray
    frames: NDArray
    shared: NDArray
    information: NDArray
    middle: NDArray

    @classmethod
    def of(
        cls,
        causes: tuple[CauseT, ...],
        parts: tuple[SharedUnknowns, ...],
        estimate: tuple[NDArray, NDArray],
        information: NDArray,
        shared: NDArray,
        nominal: NDArray | float = 0.0,
        **further: Any,
    ) -> Self:
        """Return what an estimate (n,), (n, n) hands on, of which information (n, n) is new to the next campaign.

        What is shared drew the estimate towards the nominal (n,).
        """
        mean, covariance = estimate
        middle = centred(information, information @ mean + shared @ (mean - nominal))
        frames = np.zeros_like(information)
        return cls(causes, parts, mean, covariance, frames, shared, information, middle, **further)

    @property
    def scale(self) -> NDArray:
        """Return what a unit of each number (n,) is in SI."""
        return np.concatenate([part.scale for part in self.parts]) if self.parts else np.zeros(0)

    def places(self, model: PartitionedModel) -> NDArray:
        """Return where the numbers (n,) stand among a model's shared unknowns."""
        slices = [model.layout[part.name] for part in self.parts]
        return np.concatenate([np.arange(own.start, own.stop) for own in slices]) if slices else np.zeros(0, int)

    def values(self, model: PartitionedModel, shared: NDArray) -> NDArray:
        """Return the numbers (n,) at a model's shared unknowns (G,)."""
        return shared[self.places(model)]

    def slopes(self, model: PartitionedModel, shared: NDArray) -> NDArray:
        """Return how the numbers follow their own unknowns (n, n): they are these."""
        return np.eye(len(self.mean))

    def rows(self, model: PartitionedModel, shared: NDArray) -> tuple[NDArray, NDArray]:
        """Return the knowledge as whitened rows at shared unknowns (G,): residual (E,) and derivative (E, G)."""
        variances, directions = np.linalg.eigh(self.information)
        kept = variances > 0
        factor = directions[:, kept].T * np.sqrt(variances[kept])[:, None]
        derivative = np.zeros((len(factor), model.shared_size))
        derivative[:, self.places(model)] = factor @ self.slopes(model, shared)
        return factor @ (self.middle - self.values(model, shared)), derivative

    def without(self, free: Sequence[int]) -> Self:
        """Return the same where some numbers, by their places (of n), may have changed since: nothing is known then."""
        return replace(self, information=marginal(self.information, np.asarray(free, int)))

    @property
    def nothing(self) -> Self:
        """Return the same without its knowledge: only the effects are left."""
        return replace(self, information=np.zeros_like(self.information))


def persistent_causes(
    causes: Sequence[CauseT], legs: int, covariates: Mapping[str, NDArray], given: Collection[str]
) -> tuple[CauseT, ...]:
    """Return the effects that stay with the machine and that the next campaign can predict.

    It has the columns that they depend on: covariates, with a number at every epoch, or ``given`` beside these.
    """

    def has(name: str) -> bool:
        return name in given or (name in covariates and bool(np.isfinite(covariates[name]).all()))

    return tuple(cause for cause in causes if cause.is_persistent and all(map(has, cause.needs(legs))))


def block_diagonal(*blocks: NDArray) -> NDArray:
    """Return the matrix that has blocks (n, m) along its diagonal."""
    sizes = np.cumsum([(0, 0), *(block.shape for block in blocks)], 0)
    whole = np.zeros(tuple(sizes[-1]))
    for (row, column), block in zip(sizes[:-1], blocks, strict=True):
        whole[row : row + block.shape[0], column : column + block.shape[1]] = block
    return whole


def centred(information: NDArray, pull: NDArray) -> NDArray:
    """Return where information (n, n) with its pull (n,), their product, is centred; zero where nothing is told."""
    variances, directions = np.linalg.eigh(information)
    reported = variances > _TOLD * max(1.0, variances.max(initial=0.0))
    return np.asarray(directions[:, reported] @ ((directions[:, reported].T @ pull) / variances[reported]))


def clipped(information: NDArray) -> NDArray:
    """Return a symmetric matrix without what rounding leaves of negative information."""
    variances, directions = np.linalg.eigh((information + information.T) / 2)
    return np.asarray((directions * np.maximum(variances, 0.0)) @ directions.T)


def marginal(information: NDArray, free: NDArray) -> NDArray:
    """Return the information (n, n) on the others where numbers at ``free`` are not known; zero for these."""
    if not len(free):
        return information
    own = information[np.ix_(free, free)]
    carried = information[:, free] @ np.linalg.pinv(own, rcond=1e-12, hermitian=True) @ information[free]
    left = information - carried
    left[free], left[:, free] = 0.0, 0.0
    return clipped(left)
