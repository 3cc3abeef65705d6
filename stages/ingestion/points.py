"""Points of a campaign as a stream: normalised and checked, with all faults raised at its end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Mask
from truing.formats.evaluation import TableBatch, coordinates
from truing.formats.faultlog import MOST_LISTED, CellFaults, FaultLog
from truing.formats.point_index import PointIndex
from truing.formats.raw_tables import COORDINATE_SIGMAS, POINTS
from truing.formats.read import FileRows, prefetched, read_table
from truing.formats.source import CampaignFiles
from truing.report.numbers import count_text
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.column import LEAST_SIGMA_MM, MOST_SIGMA_MM
from truing.schemas.faults import Fault
from truing.schemas.near_names import did_you_mean, meant_by
from truing.stages.ingestion.relabelling import Relabelling
from truing.stages.ingestion.unlabelled_points import (
    MOST_UNLABELLED,
    Unlabelled,
    rows_of,
    surveyed_bodies,
    without_target,
)

if TYPE_CHECKING:
    from truing.stages.declaration import Progress
    from truing.stages.ingestion.adjusted_points import AdjustedPoints

_SAME_BODY = 3.0
_OTHER_PLACES = 20.0
_EXPECTED_SIGMA = f"a standard deviation above 0, from {LEAST_SIGMA_MM:g} to {MOST_SIGMA_MM:g} mm"
_SEVERAL_READINGS = (
    "; of several readings of one pose, give their mean, or give each a pose of its own with the same inputs "
    "(repeat_of)"
)
_CORRELATIONS = ("corr_xy", "corr_xz", "corr_yz")
_SAMPLED_POSES = 5
_SAME_RATIO = 1.5  # largest over smallest ratio of distances, if only the unit differs
_MANY = 1 << 20


@dataclass(frozen=True)
class Geometry:
    """Bodies in other tables: surveyed targets and joints by body, in mm. ``survey_file``: file of the survey."""

    survey: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)
    joints: Mapping[str, Array] = field(default_factory=dict)
    survey_file: str = "targets.csv"


def size_faults(
    file: str, points: Mapping[tuple[int, str], Mapping[str, Array]], geometry: Geometry
) -> Iterator[Fault]:
    """Faults of body size: a body must be as large as in the survey, and comparable to its joints.

    A ratio of 3 between equal targets is a fault; gross errors and deformation stay below. Between targets and joints
    the limit is 20, because their positions differ; a wrong unit gives at least 25.4.
    """
    for body in dict.fromkeys(body for _, body in points):
        surveyed = geometry.survey.get(body, {})
        ratios = [_ratio(seen, surveyed) for (_, name), seen in points.items() if name == body]
        ratio = float(np.median([value for value in ratios if value > 0.0] or [1.0]))
        if not 1.0 / _SAME_BODY < ratio < _SAME_BODY:
            yield _fault(file, body, ratio, f"in {geometry.survey_file}")
    for body, joints in geometry.joints.items():
        named = geometry.survey.get(body)
        survey_file = geometry.survey_file if named else file
        seen = named or next((targets for (_, name), targets in points.items() if name == body), {})
        ratio = _size(np.array(list(seen.values()))) / _size(joints) if len(seen) > 1 and _size(joints) else 1.0
        if not 1.0 / _OTHER_PLACES < ratio < _OTHER_PLACES and ratio > 0.0:
            yield _fault(survey_file, body, ratio, "by [mechanism] legs of campaign.toml")


def _fault(file: str, body: str, ratio: float, where: str) -> Fault:
    size = f"{ratio:.3g} times that size"
    return Fault(file, f"body {body} to be as large as {where}; is the unit right?", column="x_mm", value=size)


def _ratio(seen: Mapping[str, Array], surveyed: Mapping[str, Array]) -> float:
    """Ratio of a body's size to its survey, by distances of common targets; 0 if unknown, or if the distances differ in
    their ratios: then single targets are wrong, and not the unit."""
    common = [target for target in seen if target in surveyed]
    distances, expected = (_distances(np.array([points[target] for target in common])) for points in (seen, surveyed))
    if not expected.size or not expected.min() > 0.0:
        return 0.0
    ratios = distances / expected
    return float(np.median(ratios)) if ratios.max() <= _SAME_RATIO * ratios.min() else 0.0


def _distances(points: Array) -> Array:
    """Distances between all pairs of points (T, 3), flat."""
    first, second = np.triu_indices(len(points), 1)
    return np.asarray(np.linalg.norm(points[first] - points[second], axis=-1)) if len(points) > 1 else np.empty(0)


def _size(points: Array) -> float:
    """Median distance between pairs of some points (N, 3), robust to gross errors."""
    if len(points) < 2:
        return 0.0
    some = points[np.linspace(0, len(points) - 1, min(len(points), 40)).astype(int)]
    distance = np.linalg.norm(some[:, None] - some[None], axis=-1)
    return float(np.median(distance[np.triu_indices(len(some), 1)]))


@dataclass(frozen=True)
class ExpectedPoints:
    """Constraints on the points from other tables. ``poses``: all allowed poses; ``always``: bodies required in every
    pose; ``bodies``: all allowed bodies (empty: any); ``reference``: reference body."""

    poses: pa.Array
    always: tuple[str, ...]
    bodies: tuple[str, ...]
    reference: str | None
    point_mm: float | None
    geometry: Geometry
    survey: pa.Table | None
    relabelled: tuple[Relabelling, ...] = ()

    def without(self, scanned: set[str]) -> ExpectedPoints:
        """Return the same without bodies that have dense scans and so need no targets."""
        always = tuple(body for body in self.always if body not in scanned)
        return replace(self, always=always, reference=None if self.reference in scanned else self.reference)


@dataclass
class Points:
    """The stream of points, and its statistics once it has been read."""

    source: CampaignFiles
    log: FaultLog
    expected: ExpectedPoints
    progress: Progress
    adjusted: AdjustedPoints | None = None
    left_out: Counter[tuple[str, str]] = field(default_factory=Counter)
    files: dict[str, None] = field(default_factory=dict)
    sample: list[tuple[NDArray, NDArray, NDArray]] = field(default_factory=list)
    unlabelled: Unlabelled = field(default_factory=Unlabelled)
    rows: int = 0
    labels: int = 0
    bodies: tuple[str, ...] = ()
    poses: int = 0

    def __post_init__(self) -> None:
        self._ledger = PointIndex(self.expected.poses, self.source.scratch)
        self._declared: pa.Array | None = None
        self._with_own_names: set[str] = set()

    @property
    def read(self) -> str:
        """Number of points, and their files, in words."""
        files = f"{len(self.files)} files" if len(self.files) != 1 else next(iter(self.files))
        return f"{count_text(self.rows, 'point')} of {count_text(self.poses, 'pose')} from {files}"

    @property
    def figure(self) -> str:
        """Number of targets by body, in words."""
        names = ", ".join(self.bodies[:12])
        return f"{count_text(self.labels, 'target')} of {count_text(len(self.bodies), 'body')} ({names})"

    def stream(self) -> pa.RecordBatchReader:
        """Yield the observations; raises CampaignFaults at the end if any input of the campaign is faulty."""
        batches = self._batches()
        first = next(batches, None)
        if first is None:
            self._finish()
            return pa.RecordBatchReader.from_batches(self._schema(()), iter(()))
        correlated = tuple(name for name in (*_CORRELATIONS, "point") if name in first.columns)
        schema = self._schema(correlated)
        return pa.RecordBatchReader.from_batches(schema, self._records(first, batches, schema))

    def _schema(self, correlated: tuple[str, ...]) -> pa.Schema:
        text = not pa.types.is_int64(self.expected.poses.type)
        schema = ARTIFACTS["observations"].arrow_schema("string" if text else "int64", correlated)
        names = pa.dictionary(pa.int32(), pa.string())
        fields = [f.with_type(names) if pa.types.is_string(f.type) else f for f in schema]
        return pa.schema(fields)

    def _records(
        self, first: TableBatch, later_batches: Iterator[TableBatch], schema: pa.Schema
    ) -> Iterator[pa.RecordBatch]:
        for batch in chain((first,), later_batches):
            if not self.log:
                yield pa.record_batch([batch.columns[name] for name in schema.names], schema=schema)
        self._finish()

    def _batches(self) -> Iterator[TableBatch]:
        total = len(self.source.entries("points"))
        for file, batch in prefetched(self._read()):
            self.files[file.raw.name] = None
            self.left_out.update({(file.raw.name, reason): count for reason, count in batch.left_out.items()})
            self.progress(0, total, count_text(self.rows, "point"))
            named = self._renamed(self._named_part(file, batch))
            if named.rows:
                self._with_own_names.update(named.columns["body"].unique().to_pylist())
                yield self._checked_batch(file, named)
        yield from self._labelled()

    def _read(self) -> Iterator[tuple[FileRows, TableBatch]]:
        """Yield the points of raw files, or of photographs."""
        if self.adjusted is None:
            return read_table(self.source, POINTS, self.log, poses_as_text=self._poses_are_text)
        adjusted = self.adjusted.as_text() if self._poses_are_text else self.adjusted
        return adjusted.batches(self.expected.geometry.survey, self.expected.bodies, self.log)

    def _named_part(self, file: FileRows, batch: TableBatch) -> TableBatch:
        """Yield the points with names; the others are held until their pose is complete."""
        nameless = without_target(batch)
        if "target" in batch.columns and "body" not in batch.columns:
            self.log.add(Fault(file.raw.name, "a column body, or constants = { body = ... }", column="body"))
            return rows_of(batch, np.zeros(batch.rows, dtype=bool))
        if not nameless.any():
            return batch
        self.unlabelled.add(file, rows_of(batch, nameless))
        return rows_of(batch, ~nameless)

    def _renamed(self, batch: TableBatch) -> TableBatch:
        if not batch.rows or not any(part.rules for part in self.expected.relabelled):
            return batch
        pose = self._ledger.pose_numbers(batch.columns["pose"])
        for part in self.expected.relabelled:
            batch = part.applied(batch, pose)
        return batch

    def _labelled(self) -> Iterator[TableBatch]:
        if not self.unlabelled.parts:
            return
        file = self.unlabelled.parts[0][0].raw.name
        if self.expected.survey is None and self.source.has_photographs and self.rows:
            count = sum(batch.rows for _, batch in self.unlabelled.parts)
            self.left_out[file, "circles without a code: no survey (targets.csv) names them by its geometry"] += count
            return
        if self.expected.survey is None:
            text = "targets.csv (or [files.targets]): points without names are named by the survey's geometry"
            self.log.add(Fault(file, text, column="target"))
            return
        if self.expected.point_mm is None:
            self.log.add(Fault("campaign.toml", "the noise of a point, to name points by", column="noise.point_mm"))
            return
        survey = surveyed_bodies(self.expected.survey, self.expected.point_mm)
        for raw, batch in self.unlabelled.identified_batches(survey, self.expected.point_mm, self.progress):
            if batch.rows:
                yield self._checked_batch(raw, batch)
        self.left_out.update(self.unlabelled.left_out)
        for pose, count in self.unlabelled.too_many.items():
            text = f"at most {MOST_UNLABELLED} points without names in a pose; "
            text += "a surface scanned densely is the table scans"
            self.log.add(Fault(file, text, value=f"{count} in pose {pose}"))
        # in photographs, screws and holes are circles as well: next to targets with names they are only left out
        bodies_by_codes = self._with_own_names if self.source.has_photographs else set()
        for body, why in self.unlabelled.unnamed_bodies().items():
            if body in bodies_by_codes:
                continue
            self.log.add(Fault(file, f"points that can be named as targets of body {body}", column="target", value=why))

    @property
    def _poses_are_text(self) -> bool:
        return not pa.types.is_int64(self.expected.poses.type)

    def _checked_batch(self, file: FileRows, batch: TableBatch) -> TableBatch:
        pose, label = self._ledger.add(file, batch)
        self.rows += batch.rows
        known = len(self.expected.poses)
        if is_unknown := int(pose.max()) >= known:
            which = f"a pose of configurations{self._meant_pose(batch, int(np.argmax(pose >= known)))}"
            faults = CellFaults.where(pose >= known, batch.records, batch.columns["pose"], "pose", which)
            self.log.cells(file.raw.name, faults, file.locate)
        if int(pose.min()) < min(_SAMPLED_POSES, known):
            sampled = pose < min(_SAMPLED_POSES, known)
            self.sample.append((pose[sampled], label[sampled], coordinates(batch)[sampled]))
        columns = dict(batch.columns)
        if self._poses_are_text and not is_unknown:
            columns["pose"] = pa.DictionaryArray.from_arrays(pa.array(pose), self.expected.poses)
        columns["body"], columns["target"] = self._ledger.label_columns(label)
        for name in COORDINATE_SIGMAS:
            self._check_sigma(file, batch, name)
            columns[name] = self._sigma(file, columns.get(name), batch.rows)
        return TableBatch(columns, batch.records)

    def _meant_pose(self, batch: TableBatch, row: int) -> str:
        """Return a suggestion for an unknown pose; it names the pose, because other rows may have another one."""
        name = str(batch.columns["pose"][row].as_py())
        return meant_by([name], map(str, self.expected.poses.to_pylist()))

    def _check_sigma(self, file: FileRows, batch: TableBatch, name: str) -> None:
        if name in batch.columns:
            sigma = np.asarray(batch.columns[name].fill_null(1.0))
            absurd = ((sigma >= 0.0) & (sigma < LEAST_SIGMA_MM)) | (sigma > MOST_SIGMA_MM)
            faults = CellFaults.where(absurd, batch.records, batch.columns[name], name, _EXPECTED_SIGMA)
            self.log.cells(file.raw.name, faults, file.locate)

    def _sigma(self, file: FileRows, sigma: pa.Array | None, rows: int) -> pa.Array:
        declared = self.expected.point_mm
        if sigma is not None and not sigma.null_count:
            return sigma
        if declared is None:
            self.log.add_missing("noise.point_mm", "a standard deviation of the points", file.raw.name)
            return pa.nulls(rows, pa.float64())
        if sigma is not None:
            return sigma.fill_null(declared)
        if self._declared is None or len(self._declared) < rows:
            self._declared = pa.array(np.full(max(rows, _MANY >> 3), declared))
        return self._declared.slice(0, rows)

    # -- at the end ---------------------------------------------------------------------------------------

    def _finish(self) -> None:
        for part in self.expected.relabelled[:1]:  # of those that a later survey moves, no point need be there
            part.check(self.log, self._ledger.labels.values)
        self._check_duplicates()
        self._check_bodies()
        if not self.rows and not self.log:
            why = (
                "; ".join(
                    f"{count_text(count, 'row')}: {reason}" for (_, reason), count in self.left_out.most_common(1)
                )
                or None
            )
            expected = "at least one point that is not left out"
            self.log.add(Fault(next(iter(self.files), "points.csv"), expected, value=why))
        file = next(iter(self.files), "points.csv")
        for fault in size_faults(file, self._sampled(), self.expected.geometry):
            of_rays = "" if self.adjusted is None else " Rays alone give no scale: scale_bars.csv, known_points.csv"
            self.log.add(replace(fault, expected=fault.expected + of_rays))
        self.labels, self.bodies = len(self._ledger.labels.values), self._ledger.bodies()
        self._ledger.close()
        self.log.raise_faults()

    def _sampled(self) -> dict[tuple[int, str], dict[str, Array]]:
        """Return points of a few poses: by pose and body, target to coordinates in mm."""
        samples: dict[tuple[int, str], dict[str, Array]] = {}
        for poses, labels, points in self.sample:
            for pose, label, point in zip(poses.tolist(), labels.tolist(), points, strict=True):
                body, target = self._ledger.labels.values[label]  # type: ignore[misc]
                samples.setdefault((pose, body), {})[target] = point
        return samples

    def _check_duplicates(self) -> None:
        for rows in self._ledger.duplicates():
            for shown, row in enumerate(rows.tolist()[:MOST_LISTED]):
                file, record = self._ledger.origin(row)
                pose, body, target = self._ledger.name_of(row)
                value = f"pose {pose}, {body}, {target}"
                count = len(rows) - MOST_LISTED + 1 if shown == MOST_LISTED - 1 else 1
                relabelled = "".join(part.name_in_files(pose, body, target) for part in self.expected.relabelled)
                text = relabelled or _SEVERAL_READINGS
                faults = CellFaults(f"each pose, body and target once{text}", None, ((record, value),), count)
                self.log.cells(file.raw.name, faults, file.locate)

    def _check_bodies(self) -> None:
        is_observed, bodies = self._ledger.seen()[: len(self.expected.poses)], self._ledger.bodies()
        self.poses = int(np.count_nonzero(is_observed.any(axis=1)))
        if not self.rows:
            return
        file = next(iter(self.files))
        for body in bodies:
            if self.expected.bodies and body not in self.expected.bodies:
                hint = did_you_mean(body, self.expected.bodies) or f"; there are {', '.join(self.expected.bodies)}"
                row, count = self._ledger.rows_of(body)
                origin, record = self._ledger.origin(row)
                faults = CellFaults(f"a body of the mechanism{hint}", "body", ((record, body),), count)
                self.log.cells(origin.raw.name, faults, origin.locate)
        for body in dict.fromkeys((*self.expected.always, *filter(None, (self.expected.reference,)))):
            if body not in bodies:
                text = f"points of body {body}; there are points of {', '.join(bodies)}{did_you_mean(body, bodies)}"
                self.log.add(Fault(file, text, column="body"))
            elif body in self.expected.always and not self.unlabelled.parts:
                self._check_every_pose(file, body, is_observed.any(axis=1) & ~is_observed[:, bodies.index(body)])
        self._check_names(file)

    def _check_names(self, file: str) -> None:
        """Report surveyed bodies that do not occur, and bodies none of whose targets the survey contains."""
        labels = self._ledger.labels.values
        surveyed_bodies, bodies = list(self.expected.geometry.survey), self._ledger.bodies()
        if surveyed_bodies and not set(surveyed_bodies) & set(bodies):
            text = f"points of a body that was surveyed ({', '.join(surveyed_bodies)})"
            text += meant_by(bodies, surveyed_bodies)
            self.log.add(Fault(file, text, column="body", value=", ".join(bodies)))
        for body, surveyed in self.expected.geometry.survey.items():
            seen = [target for name, target in labels if name == body]
            if seen and not any(target in surveyed for target in seen):
                text = f"targets of {body} by the names they have in the survey ({', '.join(list(surveyed)[:3])}, ...)"
                text += meant_by(seen, surveyed)
                self.log.add(Fault(file, text, column="target", value=", ".join(seen[:3])))

    def _check_every_pose(self, file: str, body: str, without: Mask) -> None:
        for pose in np.flatnonzero(without).tolist():
            value = f"pose {self.expected.poses[pose].as_py()} has none"
            self.log.add(Fault(file, f"points of body {body} in every pose", column="body", value=value))
