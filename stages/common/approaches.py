"""Approaches of a positioning run, converted to rows of an axis: targets are its commands, positions its readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask
from truing.estimation.interferometry.approaches import gross_errors, resolution
from truing.schemas.column import LEAST_SIGMA_MM, MOST_SIGMA_MM
from truing.schemas.mechanism import AxisMechanism
from truing.schemas.sections import Noise
from truing.stages.common.point_arrays import number_column

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

COMMAND, MEASURED = "command_mm", "measured_mm"
_FEWEST_FREEDOM = 8  # degrees of freedom of the noise
_CHANCE = 1e-3
_START_BEFORE = 0.5  # where a movement to a target starts, as a share of the smallest distance between targets
_TEMPERATURE = "material_temperature_c"
_ROUNDING_SIGMA = 0.289  # standard deviation of rounding, in steps of the readings
_ITERATIONS = 20


def has_only_approaches(tables: Mapping[str, pa.Table]) -> bool:
    """True if positions of an axis were recorded, and no load, reading or signal."""
    recorded = [name for name in ("positions", "readings", "signals") if name in tables and tables[name].num_rows]
    return recorded == ["positions"]


def why_no_diagnosis_of_approaches(positions: pa.Table) -> str:
    """Reason why the approaches (positions.parquet) allow no diagnosis; else empty."""
    runs = dict.fromkeys(map(str, positions.column("run").to_pylist()))
    if len(runs) > 1:
        first = next(iter(runs))
        own = f'give each a campaign of its own, by select = {{ run = "{first}" }} in [files.positioning]'
        return f"needs one run, the same axis throughout, found {len(runs)}: {own}"
    targets, _, cycles = _deviations(positions).shape
    if (freedom := _freedom(targets, cycles)) < _FEWEST_FREEDOM:
        return (
            f"the noise is unknown: {targets} targets in {cycles} cycles leave {freedom} degrees of freedom, "
            f"{_FEWEST_FREEDOM} are needed"
        )
    if (noise := noise_mm(positions)) < LEAST_SIGMA_MM:
        return "the noise is unknown: approaches of a target repeat in every digit"
    if noise > MOST_SIGMA_MM:
        return f"approaches of a target scatter by {noise:.3g} mm, more than the noise of any instrument"
    return ""


def axis_of_approaches(tables: Mapping[str, pa.Table], settings: Campaign) -> tuple[dict[str, pa.Table], Campaign]:
    """Tables with configurations, and settings, of a linear axis whose targets are commands.

    The noise is the scatter of the approaches within target and direction, without the mean of each cycle. Gross
    errors lose their reading. Before each approach a row without a reading is inserted, on the side from which the axis
    came. Raises ValueError with the reason if the noise cannot be determined.
    """
    positions = tables["positions"]
    if reason := why_no_diagnosis_of_approaches(positions):
        raise ValueError(reason)
    mechanism = AxisMechanism(type="axis", kind="linear", command=COMMAND)
    axis_settings = _AxisSettings(settings, Noise(measured_mm=noise_mm(positions)), mechanism)
    return {**tables, "configurations": _configurations(positions)}, cast("Campaign", axis_settings)


@dataclass(frozen=True)
class _AxisSettings:
    """Settings of a campaign whose mechanism is an axis, with the noise of its instrument; all else as recorded."""

    recorded: Campaign
    noise: Noise
    mechanism: AxisMechanism

    def __getattr__(self, name: str) -> object:
        if name not in vars(type(self))["__dataclass_fields__"] and not name.startswith("__"):
            return getattr(self.recorded, name)
        raise AttributeError(name)  # of an empty instance, as pickle and copy make it first


def noise_mm(positions: pa.Table) -> float:
    """One standard deviation of an approach, mm, without drift between cycles and without gross errors."""
    deviation, gross = _deviations(positions), gross_approaches(positions)
    usable = np.where(gross, np.nan, deviation)
    for _ in range(_ITERATIONS):  # of alternating means: exact at once without gaps
        usable = usable - np.nanmean(usable, axis=2, keepdims=True)
        usable = usable - np.nanmean(usable, axis=0, keepdims=True)
    targets, _, cycles = deviation.shape
    freedom = _freedom(targets, cycles) - int(gross.sum())
    step = resolution(number_column(positions, "position_mm"))
    return float(np.hypot(np.sqrt(np.nansum(usable**2) / max(freedom, 1)), _ROUNDING_SIGMA * step))


def gross_approaches(positions: pa.Table) -> Mask:
    """Approaches (P, 2, C) far from the others of their target and direction, as check position-errors names them."""
    step = resolution(number_column(positions, "position_mm"))
    return gross_errors(_deviations(positions), _CHANCE, 0.5 * step).where


def _freedom(targets: int, cycles: int) -> int:
    return 2 * (targets - 1) * (cycles - 1)


def _deviations(positions: pa.Table) -> Array:
    """Position minus target (P, 2, C), mm, of the only run, whose rows are in order of target, direction and cycle."""
    deviation = number_column(positions, "position_mm") - number_column(positions, "target_mm")
    return deviation.reshape(len(np.unique(number_column(positions, "target_mm"))), 2, -1)


def _configurations(positions: pa.Table) -> pa.Table:
    """Rows in order of time: before each approach one without a reading, on the side from which it came."""
    order = _order(positions)
    in_order = positions.take(order)
    measured = np.where(gross_approaches(positions).ravel(), np.nan, number_column(positions, "position_mm"))[order]
    target, count = number_column(in_order, "target_mm"), in_order.num_rows
    side = np.where(np.array(in_order.column("direction").to_pylist()) == "forward", -1.0, 1.0)
    before = target + side * _START_BEFORE * float(np.diff(np.unique(target)).min())
    pose = np.arange(1, count + 1) if "row_order" not in in_order.column_names else number_column(in_order, "row_order")

    def interleaved(first: Array, second: Array) -> Array:
        return np.column_stack([first, second]).ravel()

    columns = {
        "pose": interleaved(-pose, pose).astype(np.int64),
        "role": ["calibration"] * (2 * count),
        "time_s": np.arange(2.0 * count),  # counted: whole seconds are no motion between targets
        "run": [f"cycle {cycle}" for cycle in in_order.column("cycle").to_pylist() for _ in range(2)],
        COMMAND: interleaved(before, target),
        MEASURED: interleaved(np.full(count, np.nan), measured),
    }
    if _TEMPERATURE in in_order.column_names:
        temperature = number_column(in_order, _TEMPERATURE)
        columns[_TEMPERATURE] = interleaved(temperature, temperature)
    return pa.table(columns)


def _order(positions: pa.Table) -> Index:
    """Order of measurement: of the rows, if the axis moved in it as recorded, else cycle by cycle, up and down."""
    target, cycle = number_column(positions, "target_mm"), number_column(positions, "cycle")
    sense = np.where(np.array(positions.column("direction").to_pylist()) == "forward", 1.0, -1.0)
    if "row_order" in positions.column_names:
        rows = np.argsort(number_column(positions, "row_order"))
        steps = np.diff(target[rows])
        turns = (np.diff(sense[rows]) != 0.0) | (np.diff(cycle[rows]) != 0.0)
        # A file with a row for each target has its cycles side by side, and shows no movement.
        passes = len(set(zip(cycle.tolist(), sense.tolist(), strict=True)))
        if turns.sum() < passes and np.all((steps == 0.0) | (np.sign(steps) == sense[rows][1:])):
            return rows
    return np.lexsort((sense * target, -sense, cycle))
