"""Class `CampaignPrior`: results of a prior campaign of the same machine or sensor, as whitened rows for the next fit.

A prior model contains tolerances and the results of its campaign. Only the latter are passed on, so that tolerances
enter the next campaign only once.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from truing.simulation.cause import CauseT

_NEGLIGIBLE = 1e-9  # information below this share of the largest, or of the prior's (1), counts as zero


class PartitionedModel(Protocol):
    """A model whose vector of shared unknowns (G,) consists of named parts."""

    @property
    def layout(self) -> dict[str, slice]:
        """Slice of each part."""

    @property
    def shared_size(self) -> int:
        """Number of shared unknowns G."""


@dataclass(frozen=True)
class SharedUnknowns:
    """A part of the unknowns that both campaigns have: its name in the layout, and the scale (n,) of each number."""

    name: str
    scale: NDArray


@dataclass(frozen=True)
class CampaignPrior(Generic[CauseT]):
    """Results of a prior campaign for n numbers of the next one, relative to the next one's nominal values.

    All arrays are in units of the parts' scales:
    - mean (n,), covariance (n, n): estimate of the prior campaign;
    - frames (n, n): additional covariance by another survey;
    - shared (n, n): part of its information that the next campaign has too (tolerances, and the survey if it is the
      same);
    - information (n, n), middle (n,): the new information and its centre. The centre differs from the mean, because
      shared information enters again with the next campaign.

    ``causes`` are the persistent effects of the prior campaign.
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
        """Return the prior from an estimate (mean, covariance), with the information (n, n) that is new to the next
        campaign.

        The shared information drew the estimate towards the nominal values (n,).
        """
        mean, covariance = estimate
        middle = centred(information, information @ mean + shared @ (mean - nominal))
        frames = np.zeros_like(information)
        return cls(causes, parts, mean, covariance, frames, shared, information, middle, **further)

    @property
    def scale(self) -> NDArray:
        """SI value of one unit of each number (n,)."""
        return np.concatenate([part.scale for part in self.parts]) if self.parts else np.zeros(0)

    def places(self, model: PartitionedModel) -> NDArray:
        """Return the indices of the numbers (n,) among a model's shared unknowns."""
        slices = [model.layout[part.name] for part in self.parts]
        return np.concatenate([np.arange(part.start, part.stop) for part in slices]) if slices else np.zeros(0, int)

    def values(self, model: PartitionedModel, shared: NDArray) -> NDArray:
        """Return the numbers (n,) at a model's shared unknowns (G,)."""
        return shared[self.places(model)]

    def slopes(self, model: PartitionedModel, shared: NDArray) -> NDArray:
        """Return the derivative (n, n) of the numbers by their unknowns: the identity."""
        return np.eye(len(self.mean))

    def rows(self, model: PartitionedModel, shared: NDArray) -> tuple[NDArray, NDArray]:
        """Return the prior as whitened rows at shared unknowns (G,): residual (E,) and derivative (E, G)."""
        variances, directions = np.linalg.eigh(self.information)
        is_free = variances > 0
        factor = directions[:, is_free].T * np.sqrt(variances[is_free])[:, None]
        derivative = np.zeros((len(factor), model.shared_size))
        derivative[:, self.places(model)] = factor @ self.slopes(model, shared)
        return factor @ (self.middle - self.values(model, shared)), derivative

    def without(self, free: Sequence[int]) -> Self:
        """Return the prior without information on numbers, by index, that may have changed since."""
        return replace(self, information=marginal(self.information, np.asarray(free, int)))

    @property
    def without_information(self) -> Self:
        """The prior with its effects, but without its information."""
        return replace(self, information=np.zeros_like(self.information))


def persistent_causes(
    causes: Sequence[CauseT], legs: int, covariates: Mapping[str, NDArray], recorded: Collection[str]
) -> tuple[CauseT, ...]:
    """Return the persistent causes whose input columns the next campaign has.

    A column is a covariate that is finite at every epoch, or is listed in ``recorded``.
    """

    def has(name: str) -> bool:
        return name in recorded or (name in covariates and bool(np.isfinite(covariates[name]).all()))

    return tuple(cause for cause in causes if cause.is_persistent and all(map(has, cause.needs(legs))))


def block_diagonal(*blocks: NDArray) -> NDArray:
    """Return the block-diagonal matrix of blocks (n, m)."""
    sizes = np.cumsum([(0, 0), *(block.shape for block in blocks)], 0)
    matrix = np.zeros(tuple(sizes[-1]))
    for (row, column), block in zip(sizes[:-1], blocks, strict=True):
        matrix[row : row + block.shape[0], column : column + block.shape[1]] = block
    return matrix


def centred(information: NDArray, pull: NDArray) -> NDArray:
    """Return the centre (n,) of information (n, n) from their product; zero in directions without information."""
    variances, directions = np.linalg.eigh(information)
    reported = variances > _NEGLIGIBLE * max(1.0, variances.max(initial=0.0))
    return np.asarray(directions[:, reported] @ ((directions[:, reported].T @ pull) / variances[reported]))


def clipped(information: NDArray) -> NDArray:
    """Return a symmetric matrix with negative eigenvalues, which stem from rounding, set to zero."""
    variances, directions = np.linalg.eigh((information + information.T) / 2)
    return np.asarray((directions * np.maximum(variances, 0.0)) @ directions.T)


def marginal(information: NDArray, free: NDArray) -> NDArray:
    """Return the information (n, n) with the numbers at ``free`` marginalised; zero in their rows and columns."""
    if not len(free):
        return information
    block = information[np.ix_(free, free)]
    carried = information[:, free] @ np.linalg.pinv(block, rcond=1e-12, hermitian=True) @ information[free]
    left = information - carried
    left[free], left[:, free] = 0.0, 0.0
    return clipped(left)
