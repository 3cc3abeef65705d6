"""Common parts of plans of simulated campaigns: gross errors, stages before the diagnosis, and parts of the machine."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, Self


class _NumberedParts(Protocol):
    """A model whose parameters are numbered by its parts: legs, joints or channels."""

    @property
    def part_count(self) -> int:
        """Return the number of parts."""


class _WithModel:
    """Anything with a model; not a dataclass, so that ``model`` stays the first field of a plan."""

    model: _NumberedParts


@dataclass(frozen=True, kw_only=True)
class ModelPlan(_WithModel):
    """Base class of plans with one model.

    ``gross``: share of grossly wrong readings or points; ``through``: stages between simulated tables and diagnosis.
    """

    gross: float = 0.0
    through: tuple[str, ...] = ()

    @property
    def part_count(self) -> int:
        """Number of parts that parameters are numbered by."""
        return self.model.part_count

    def with_gross(self, share: float) -> Self:
        """Return the plan with a share of the readings or points grossly wrong."""
        return replace(self, gross=share)
