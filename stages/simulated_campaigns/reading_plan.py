"""A loading campaign as a plan that can be drawn again: its load steps, and which channels are read at each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.recorded_steps import CHANNELS, READING_SI, RecordedSteps
from truing.simulation.bench.simulation import draw_readings
from truing.simulation.cause import Effect, Scene
from truing.stages.common.reading_arrays import load_steps

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.simulation.bench.model import ReadingModel

_VOLT_MV = 1e3


@dataclass(frozen=True)
class ReadingPlan:
    """A layout of load steps, and the tables that a drawn campaign of that layout fills with other numbers.

    ``scene`` is what causes may propose candidates from, as the diagnosis offers it to them.
    """

    model: ReadingModel
    steps: RecordedSteps
    tables: Mapping[str, pa.Table]
    scene: Scene
    gross: float = 0.0

    through: tuple[str, ...] = ()  # stages between what is drawn and the diagnosis

    @property
    def part_count(self) -> int:
        """What parameters are numbered by."""
        return self.model.part_count

    def with_gross(self, share: float) -> ReadingPlan:
        """The plan with a share of the readings grossly wrong."""
        return replace(self, gross=share)

    def drawn(self, effects: Sequence[Effect], rng: np.random.Generator) -> dict[str, pa.Table]:
        """The tables of a campaign drawn anew with effects hidden in it."""
        found = draw_readings(self.model, effects, rng, self.gross)
        place = {key: row for row, key in enumerate(_keys(self.steps))}
        tables = dict(self.tables)
        if "readings" in tables:
            table = tables["readings"]
            rows = _rows(table, place)
            channel = np.array([CHANNELS.index(name) for name in table.column("channel").to_pylist()])
            tables["readings"] = _with(table, "reading", found[rows, channel] / READING_SI[channel])
        if "signals" in tables:
            rows = _rows(tables["signals"], place)
            for number, name in enumerate(self.steps.signals):
                values = found[rows, len(CHANNELS) + number] * _VOLT_MV
                tables["signals"] = _with(tables["signals"], f"{name}_mv", values)
        return tables


def reading_plan(tables: Mapping[str, pa.Table], model: ReadingModel) -> ReadingPlan:
    """The plan of a loading campaign; model: its plain simulation at all load steps."""
    steps = load_steps(tables)
    own = {name: tables[name] for name in ("readings", "signals", "given_compliance") if name in tables}
    return ReadingPlan(model, steps, own, model.scene)


def _keys(steps: RecordedSteps) -> list[tuple[int | str, int]]:
    return [(steps.runs[run], int(step)) for run, step in zip(steps.run, steps.step, strict=True)]


def _rows(table: pa.Table, place: Mapping[tuple[int | str, int], int]) -> NDArray[np.int64]:
    keys = zip(table.column("run").to_pylist(), table.column("step").to_pylist(), strict=True)
    return np.array([place[key] for key in keys])


def _with(table: pa.Table, name: str, values: NDArray[np.float64]) -> pa.Table:
    import pyarrow as pa

    place = table.schema.get_field_index(name)
    return table.set_column(place, table.schema.field(place), pa.array(values))
