"""Observed points of each body in compact arrays, from a table of any length that is read in batches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask
from truing.estimation.rigid_poses.points import CompactPoints
from truing.schemas.artifact import StoredTable, table_batches
from truing.stages.common.point_arrays import number_columns, positions

_AXES = "xyz"
_POINT = tuple(f"{a}_mm" for a in _AXES)
_SIGMA = tuple(f"sigma_{a}_mm" for a in _AXES)
_CORRELATION = ("corr_xy", "corr_xz", "corr_yz")


@dataclass(frozen=True)
class ObservedNames:
    """Poses of a table of points, and the targets of each body, in order of appearance."""

    poses: tuple[int | str, ...]
    targets: Mapping[str, tuple[str, ...]]


def observed_names(observations: pa.Table | StoredTable) -> ObservedNames:
    """Return the names in a table of points."""
    poses: dict[int | str, None] = {}
    targets: dict[str, dict[str, None]] = {}
    for batch in table_batches(observations, ("pose", "body", "target")):
        poses.update(dict.fromkeys(batch.column("pose").unique().to_pylist()))
        for body, target in _labels(batch).names:
            targets.setdefault(body, {})[target] = None
    return ObservedNames(tuple(poses), {body: tuple(names) for body, names in targets.items()})


@dataclass(frozen=True)
class _Labels:
    """Pairs of body and target of a batch in order of appearance, and the number of the pair in each row (N,)."""

    names: list[tuple[str, str]]
    number: Index


def _labels(batch: pa.Table) -> _Labels:
    body, target = (_encoded(batch.column(name)) for name in ("body", "target"))
    width = max(len(target.dictionary), 1)
    code = np.asarray(body.indices).astype(np.int64) * width + np.asarray(target.indices)
    pairs, first, number = np.unique(code, return_index=True, return_inverse=True)
    order = np.argsort(first)
    label = np.empty(len(order), np.int64)
    label[order] = np.arange(len(order))
    bodies, targets = body.dictionary.to_pylist(), target.dictionary.to_pylist()
    return _Labels([(bodies[pair // width], targets[pair % width]) for pair in pairs[order]], label[number])


def _encoded(column: pa.ChunkedArray) -> pa.DictionaryArray:
    combined = column.combine_chunks() if column.num_chunks != 1 else column.chunk(0)
    return combined if pa.types.is_dictionary(combined.type) else combined.dictionary_encode()


@dataclass
class _Filling:
    """Arrays of one body while the table is read."""

    points: Array
    is_observed: Mask
    sigma: Array = field(default_factory=lambda: np.full((1, 1, 3), np.nan))
    correlation: Array | None = None

    def add(self, pose: Index, target: Index, rows: pa.Table) -> None:
        self.points[pose, target] = number_columns(rows, _POINT) * 1e-3
        self.is_observed[pose, target] = True
        self._add_sigma(pose, target, number_columns(rows, _SIGMA) * 1e-3)
        named = [name for name in _CORRELATION if name in rows.column_names]
        if named:
            if self.correlation is None:
                self.correlation = np.zeros(self.points.shape)
            for k, name in enumerate(_CORRELATION):
                if name in named:
                    self.correlation[pose, target, k] = np.nan_to_num(number_columns(rows, [name])[:, 0])

    def _add_sigma(self, pose: Index, target: Index, sigma: Array) -> None:
        if len(self.sigma) == 1:
            common = sigma[0] if np.isnan(self.sigma).all() else self.sigma[0, 0]
            if np.array_equal(sigma, np.broadcast_to(common, sigma.shape)):
                self.sigma = common.reshape(1, 1, 3)
                return
            self.sigma = np.broadcast_to(self.sigma, self.points.shape).copy()
        self.sigma[pose, target] = sigma


def compact_points(
    observations: pa.Table | StoredTable, names: ObservedNames, bodies: Sequence[str] | None = None
) -> dict[str, CompactPoints]:
    """Return the points of bodies (default: all), in m, by body in the order of their names."""
    wanted = list(names.targets if bodies is None else bodies)
    filling = {}
    for body in wanted:
        shape = (len(names.poses), len(names.targets[body]))
        filling[body] = _Filling(np.zeros((*shape, 3)), np.zeros(shape, bool))
    index_of = {(body, target): k for body in wanted for k, target in enumerate(names.targets[body])}
    for batch in table_batches(observations, ("pose", "body", "target", *_POINT, *_SIGMA, *_CORRELATION)):
        pose, labels = positions(batch.column("pose"), names.poses), _labels(batch)
        at = np.array([index_of.get(pair, -1) for pair in labels.names], np.int64)[labels.number]
        body_number = np.array([wanted.index(body) if body in filling else -1 for body, _ in labels.names])[
            labels.number
        ]
        for number, body in enumerate(wanted):
            rows = np.flatnonzero(body_number == number)
            if len(rows):
                filling[body].add(pose[rows], at[rows], batch.take(rows))
    return {
        body: CompactPoints(
            names.poses, names.targets[body], points.points, points.sigma, points.correlation, points.is_observed
        )
        for body, points in filling.items()
    }
