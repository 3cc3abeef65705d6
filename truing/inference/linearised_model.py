"""Measured minus predicted values of a model at given unknowns, with their derivatives and priors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truing.inference.arrays import Array, Integers, Mask

# Columns that act in at most the first share of the epochs are stored only there, if no epoch keeps more than the
# second share of all columns. This saves memory where each run has an unknown zero.
_FEW_EPOCHS, _MOST_KEPT = 0.25, 0.5


@dataclass(frozen=True)
class LinearisedModel:
    """Measured minus predicted and derivatives at given unknowns; whitened, zero where missing.

    Where many shared unknowns act in few epochs each (the zeros of runs), ``by_shared`` is compact: the C columns of an
    epoch belong to the unknowns ``columns`` (B, C). The first ``common`` columns are the same in all epochs, the others
    act only there; G marks an empty column.
    """

    residual: Array  # (B, M) rows of each epoch
    by_local: Array  # (B, M, H)
    by_shared: Array  # (B, M, G), or (B, M, C)
    local_value: Array  # (B, H) distance from the prior's mean, in prior sigmas
    shared_value: Array  # (G,)
    extra_residual: Array  # (E,) rows that concern no epoch
    extra_by_shared: Array  # (E, G)
    present: Mask  # (B, M) which rows were measured
    local_known: Mask  # (H,) True where the prior is knowledge, False where it only keeps the equations scaled
    shared_known: Mask  # (G,)
    columns: Integers | None = None
    common: int = 0

    def moved(self, shared: Array) -> Array:
        """Return the change of the rows (B, M, ...) by shared unknowns (G, ...)."""
        if self.columns is None:
            return np.asarray(self.by_shared @ shared)
        own = np.concatenate([shared, np.zeros((1, *shared.shape[1:]))])[self.columns]
        return np.asarray(self.by_shared @ own if shared.ndim > 1 else (self.by_shared @ own[..., None])[..., 0])

    def without(self, epochs: Mask) -> LinearisedModel:
        """Return the problem without the measurements of some epochs (B,), whose local unknowns are zero."""
        mask = ~epochs[:, None]
        return replace(
            self,
            residual=self.residual * mask,
            by_local=self.by_local * mask[..., None],
            by_shared=self.by_shared * mask[..., None],
            local_value=self.local_value * mask,
            present=self.present & mask,
        )

    def at(self, residual: Array, local_value: Array, shared_value: Array) -> LinearisedModel:
        """Return the problem with the residuals at other unknowns, and these derivatives.

        Rows that concern no epoch move along their derivatives."""
        moved = self.extra_by_shared @ (shared_value - self.shared_value)
        return replace(
            self,
            residual=residual,
            local_value=local_value,
            shared_value=shared_value,
            extra_residual=self.extra_residual - moved,
        )

    @property
    def squares(self) -> float:
        """Sum of squares of all rows, priors included."""
        parts = (self.residual, self.local_value, self.shared_value, self.extra_residual)
        return float(sum(np.sum(np.square(part)) for part in parts))


def columns_of(acting: Mask) -> tuple[Integers, int] | None:
    """Return the columns (B, C) to store for each epoch, and the number of them that are common to all epochs.

    ``acting`` (B, G) marks the columns that act; G stands for an empty column. None where most act in most epochs.
    """
    few = acting & (acting.mean(0) <= _FEW_EPOCHS)
    common = np.flatnonzero(acting.mean(0) > _FEW_EPOCHS)
    count = few.sum(1)
    if len(common) + count.max(initial=0) > _MOST_KEPT * acting.shape[1]:
        return None
    epoch, column = np.nonzero(few)
    own = np.full((len(acting), int(count.max(initial=0))), acting.shape[1])
    own[epoch, np.arange(len(epoch)) - np.repeat(np.cumsum(count) - count, count)] = column
    return np.concatenate([np.broadcast_to(common, (len(acting), len(common))), own], 1), len(common)
