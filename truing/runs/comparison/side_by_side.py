"""Several runs of one machine in one long table, with the changes from each run to the next."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow as pa

from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS
from truing.runs.comparison.axis_step import axis_numbers, axis_step
from truing.runs.comparison.chain_step import chain_numbers, chain_step
from truing.runs.comparison.steps import (
    NAMES,
    RunStep,
    matrix_numbers,
    matrix_step,
    mechanism_numbers,
    mechanism_step,
    not_assessed,
    sensor_numbers,
    sensor_step,
)
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.settings_text import Document
from truing.simulation.axis.extended_model import ExtendedAxis
from truing.simulation.bench.extended_model import ExtendedSensor
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain
from truing.simulation.mechanisms.extended_model import ExtendedModel

if TYPE_CHECKING:
    from truing.runs.recorded_run import Run

_NTH, _CHAIN = "nth", "chain_parameters"


@dataclass(frozen=True)
class SideBySide:
    """Rows of compared.parquet, and the assessed steps from each run to the next, or the reason why there are none."""

    table: pd.DataFrame
    steps: tuple[tuple[RunStep, ...], ...]  # of each pair of neighbours


def kind_of(run: Run) -> str:
    """Return the kind of campaign of a run, judged by its tables."""
    return "a force sensor on its bench" if "readings" in run else "points on bodies"


def mechanism_of(run: Run) -> str:
    """Return the mechanism of a run, such as ``6-pus of 6 legs``; empty where it has no model of a mechanism."""
    model = run.model
    if isinstance(model, ExtendedModel):
        return f"{model.model.nominal.closure.name} of {model.model.part_count} legs"
    if isinstance(model, ExtendedChain):
        return f"chain of joints {', '.join(model.tree.readings)}"
    if isinstance(model, ExtendedAxis):
        return f"{model.axis.kind} axis"
    return ""


def side_by_side(runs: Sequence[Run]) -> SideBySide:
    """Compare runs of one machine in their order; raises ValueError for a file that no run writes."""
    numbers = [_numbers(run) for run in runs]
    steps = tuple(
        tuple(_steps(before, now, *tables))
        for (before, now), tables in zip(pairwise(runs), pairwise(numbers), strict=True)
    )
    parts = [_first(numbers[0])]
    for number, before, assessed in zip(numbers[1:], numbers, steps, strict=False):
        parts.append(_with_changes(number, before, [step.rows for step in assessed if len(step.rows)]))
    reported = [
        part.assign(place=index, folder=str(run.folder), campaign=run.campaign)
        for index, (part, run) in enumerate(zip(parts, runs, strict=True), start=1)
    ]
    return SideBySide(pd.concat(reported, ignore_index=True).reindex(columns=ARTIFACTS["compared"].columns), steps)


def compared_table(comparison: SideBySide) -> pa.Table:
    """Return the rows as the artifact ``compared``."""
    schema = ARTIFACTS["compared"].arrow_schema()
    columns = {
        name: [None if _missing(value) else _plain(value, schema.field(name).type) for value in comparison.table[name]]
        for name in schema.names
    }
    return pa.table(columns, schema)


def _missing(value: object) -> bool:
    return value is None or value != value


def _plain(value: Any, kind: pa.DataType) -> Any:
    return int(value) if str(kind) == "int64" else value


def _numbers(run: Run) -> pd.DataFrame:
    model = run.model
    parts = []
    if isinstance(model, ExtendedModel):
        parts.append(mechanism_numbers(model))
    if isinstance(model, ExtendedSensor):
        parts.append(sensor_numbers(model))
    if isinstance(model, ExtendedAxis):
        parts.append(axis_numbers(model))
    if isinstance(model, ExtendedChain):
        parts.append(chain_numbers(model, run[_CHAIN]))
    if "sensor_matrix" in run:
        parts.append(matrix_numbers(run["sensor_matrix"]))
    parts = [part.astype(dict.fromkeys(NAMES, object)) for part in parts if len(part)]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=[*NAMES, "value", "sigma", "unit"])


def _steps(before: Run, now: Run, old: pd.DataFrame, new: pd.DataFrame) -> Iterator[RunStep]:
    yield _of_models(before, now)
    matrices = [numbers[numbers["group"] == "G_B"] for numbers in (old, new)]
    if all(map(len, matrices)):
        yield (
            matrix_step(*matrices)
            if _matrix_model(before) == _matrix_model(now)
            else not_assessed(f"G_B is made otherwise ({_matrix_model(before)}, then {_matrix_model(now)})")
        )


def _of_models(before: Run, now: Run) -> RunStep:
    first, second = before.model, now.model
    absent = [run.campaign for run, model in ((before, first), (now, second)) if model is None]
    if first is None or second is None:
        return not_assessed(f"{' and '.join(absent)} left no extended model")
    if (start := now.folder / ARTIFACTS["start"].file).is_file():
        return not_assessed(_start_words(tomllib.loads(start.read_text(encoding="utf-8")), now))
    if isinstance(first, ExtendedModel) and isinstance(second, ExtendedModel):
        return mechanism_step(first, second)
    if isinstance(first, ExtendedSensor) and isinstance(second, ExtendedSensor):
        return sensor_step(first, second, _simulated(now))
    if isinstance(first, ExtendedAxis) and isinstance(second, ExtendedAxis):
        return axis_step(first, second)
    if isinstance(first, ExtendedChain) and isinstance(second, ExtendedChain):
        return chain_step(first, second, before[_CHAIN], now[_CHAIN])
    return not_assessed("they are of other machines")


def _start_words(start: Document, now: Run) -> str:
    of = start.get("model", {}).get("campaign", "an earlier campaign")
    return f"{now.campaign} started from the model of {of}, which its numbers rest on; its own page says what changed"


def _simulated(run: Run) -> np.ndarray:
    """Return the prior sigmas (36,), SI, of the simulated compliance; infinite where they are unknown."""
    sigma = np.full((6, 6), np.inf)
    if "compliance" not in run or "simulated_sigma" not in run["compliance"]:
        return sigma.ravel()
    table = run["compliance"].dropna(subset=["simulated_sigma"])
    for r in table.itertuples():
        if r.simulated_sigma > 0.0:
            sigma[CHANNELS.index(r.response), LOADS.index(r.load)] = r.simulated_sigma
    return sigma.ravel()


def _matrix_model(run: Run) -> str:
    table = run["sensor_matrix"]
    return ", ".join(dict.fromkeys(table[table["chosen"] & (table["matrix"] == "G_B")]["model"]))


def _numbered(rows: pd.DataFrame) -> pd.DataFrame:
    """Return rows with a running number among rows of the same name: two forms of one effect may share a name."""
    return rows.assign(**{_NTH: rows.groupby(NAMES, dropna=False).cumcount()})


def _first(numbers: pd.DataFrame) -> pd.DataFrame:
    return numbers.assign(changed=False)


def _with_changes(now: pd.DataFrame, before: pd.DataFrame, assessed: list[pd.DataFrame]) -> pd.DataFrame:
    """Return the numbers of a run with their assessed changes since the run before."""
    on = [*NAMES, _NTH]
    table = _numbered(now).merge(_numbered(before)[[*on, "value"]], on=on, how="left", suffixes=("", "_before"))
    table["difference"] = table["value"] - table.pop("value_before")
    if assessed:
        rows = pd.concat([row.astype(dict.fromkeys(NAMES, object)) for row in assessed], ignore_index=True)
        table = table.merge(_numbered(rows), on=on, how="left")
    table = table.reindex(columns=[*dict.fromkeys([*table.columns, "z", "changed", "reason"])])
    table["changed"] = table["changed"].eq(True)
    alone = table["difference"].isna()
    unjudged = table["z"].isna() & table["reason"].isna() & ~table["changed"]
    table["reason"] = table["reason"].astype(object)
    table.loc[unjudged, "reason"] = "not judged"
    table.loc[alone, "reason"] = "not in the run before"
    return table
