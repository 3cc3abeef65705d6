"""Poses whose points the checks examine: all of them, or some where a campaign has very many points."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.arrays import Index
from truing.quality.bodies import PoseSurroundings
from truing.report.numbers import count_text
from truing.schemas.artifact import StoredTable, full_table, plain_texts, table_batches
from truing.stages.common.point_arrays import number_column
from truing.stages.quality.check import Check

MOST_POINTS = 1_000_000
"""Largest number of points that are all examined."""
SOME_POINTS = 500_000
"""About so many points are examined where there are more."""
RUNS = 64
"""Runs of consecutive poses that are examined then: neighbours show exchanged rows, jumps and drift."""


@dataclass(frozen=True)
class PoseSample:
    """The points to examine: those of ``examined`` among ``poses``, which has all observed ones in order of appearance;
    whole: all points."""

    points: pa.Table
    poses: tuple[int | str, ...]
    examined: tuple[int | str, ...]
    whole: pa.Table | StoredTable

    @property
    def is_whole(self) -> bool:
        """True if all poses are examined."""
        return len(self.examined) == len(self.poses)

    @property
    def note(self) -> str:
        """Poses that were examined, in words; empty if all were."""
        if self.is_whole:
            return ""
        some = f"{count_text(len(self.examined), 'pose')} of {len(self.poses):,}"
        return f" Examined: {some}, in {RUNS} runs of consecutive ones."

    def noted(self, checks: Iterable[Check]) -> Iterator[Check]:
        """Yield checks with the poses that were examined."""
        return (replace(check, message=check.message + self.note) for check in checks)

    def around(self, surroundings: PoseSurroundings) -> PoseSurroundings:
        """Return the surroundings of the examined poses alone."""
        if self.is_whole:
            return surroundings
        examined = set(self.examined)
        rows = np.array([row for row, pose in enumerate(surroundings.poses) if pose in examined], dtype=np.int64)
        return replace(
            surroundings,
            poses=tuple(surroundings.poses[row] for row in rows),
            time=surroundings.time[rows],
            settings=surroundings.settings[rows],
            temperature=None if surroundings.temperature is None else surroundings.temperature[rows],
        )


def pose_sample(observations: pa.Table | StoredTable, configurations: pa.Table | None) -> PoseSample:
    """Return the points to examine: all, or those of runs of poses that are spread evenly over the time."""
    if observations.num_rows <= MOST_POINTS:
        points = full_table(observations)
        poses = tuple(points.column("pose").unique().to_pylist())
        return PoseSample(points, poses, poses, points)
    names: dict[int | str, None] = {}
    for batch in table_batches(observations, ("pose",)):
        names.update(dict.fromkeys(batch.column("pose").unique().to_pylist()))
    poses = tuple(names)
    rows = spread_runs(len(poses), max(1, len(poses) * SOME_POINTS // observations.num_rows))
    order = _in_time(poses, configurations)
    examined = tuple(poses[order[row]] for row in rows)
    wanted = pa.array(examined)
    some = [batch.filter(_is_in(batch.column("pose"), wanted)) for batch in table_batches(observations)]
    points = pa.concat_tables(some).unify_dictionaries()
    return PoseSample(plain_texts(points), poses, examined, observations)


def spread_runs(total: int, some: int) -> Index:
    """Return about ``some`` of ``total`` numbers, in runs of equal length that are spread evenly."""
    runs = min(RUNS, some)
    length = -(-some // runs)
    if some >= total or length * runs >= total:
        return np.arange(total)
    first = np.linspace(0, total - length, runs).astype(np.int64)
    return np.unique(first[:, None] + np.arange(length))


def _in_time(poses: tuple[int | str, ...], configurations: pa.Table | None) -> Index:
    """Return the numbers of poses in the order of time, or in their own order without times."""
    if configurations is None:
        return np.arange(len(poses))
    time = dict(zip(configurations.column("pose").to_pylist(), number_column(configurations, "time_s"), strict=True))
    return np.argsort([time.get(pose, np.inf) for pose in poses], kind="stable")


def _is_in(column: pa.ChunkedArray, wanted: pa.Array) -> pa.ChunkedArray:
    if pa.types.is_dictionary(column.type):
        column = column.cast(pa.string())
    return pc.is_in(column, value_set=wanted)
