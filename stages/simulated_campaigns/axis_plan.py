"""Plan of campaigns of an axis, and the rows that a simulated campaign of this layout fills."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.simulation.axis.causes import AxisCause
from truing.simulation.axis.model import AxisModel
from truing.simulation.cause import Effect, Scene
from truing.stages.common.axis_columns import AxisColumns
from truing.stages.simulated_campaigns.plan_base import ModelPlan

# Gross errors of readings, as a multiple of the noise.
_GROSS_NOISE = 100.0


@dataclass(frozen=True)
class AxisPlan(ModelPlan):
    """Layout of a campaign of an axis, and the table that a simulated campaign of this layout fills.

    ``model`` has all B rows; ``sigma`` (K,) is the noise of each encoder, rad or m, ``is_observed`` (B, K) marks its
    readings; ``scene``: input for candidate causes, as in the diagnosis.
    """

    model: AxisModel
    columns: AxisColumns
    sigma: NDArray
    is_observed: Mask
    tables: Mapping[str, pa.Table]
    scene: Scene[AxisCause]

    def drawn(self, effects: Sequence[Effect[AxisCause]], rng: np.random.Generator) -> dict[str, pa.Table]:
        """The tables of a campaign drawn anew with effects hidden in it: the axis about its commands, and noise.

        All but the effects is drawn independently of the effects; zeros of the encoders stay nominal.
        """
        hidden = self.model.with_causes([effect.cause for effect in effects])
        shared = np.zeros(hidden.shared_size)
        hidden.set_effects(shared, effects)
        local = rng.standard_normal((len(self.is_observed), hidden.local_size))
        local[:, [bool(element) for element in hidden.stops]] = 0.0  # a transmission without errors stops exactly
        exact = hidden.points(shared, local)[..., 0]
        noise = self.sigma * rng.standard_normal(exact.shape)
        wrong = rng.random(exact.shape) < self.gross
        noise += wrong * _GROSS_NOISE * self.sigma * rng.standard_normal(exact.shape)
        return {**self.tables, "configurations": self._recorded(exact + noise)}

    def _recorded(self, deviation: Array) -> pa.Table:
        """The rows with readings that deviate from their commands, (B, K), rad or m."""
        table, command = self.tables["configurations"], self.model.rows.command
        for k, column in enumerate(self.columns.encoders.values()):
            reading = self.columns.recorded(column, command + deviation[:, k])
            values = pa.array(np.where(self.is_observed[:, k], reading, np.nan), from_pandas=True)
            table = table.set_column(table.schema.get_field_index(column), column, values)
        return table


def axis_plan(
    tables: Mapping[str, pa.Table], model: AxisModel, columns: AxisColumns, sigma: NDArray, rows_sigma: float
) -> AxisPlan:
    """The plan of a campaign of an axis; ``model`` has the rows that its diagnosis compares, ``rows_sigma`` is the
    noise of the command, rad or m."""
    table = tables["configurations"]
    rows = columns.rows(table, rows_sigma)
    is_observed = np.isfinite(columns.deviations(table))
    return AxisPlan(model.at(rows), columns, sigma, is_observed, {"configurations": table}, model.scene)
