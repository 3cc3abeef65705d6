"""Identification of points without names, pose by pose, by the geometry of the surveyed targets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, Index, Mask
from truing.estimation.labels.labelling import Labelling, LabellingStatus, label_bodies
from truing.formats.dictionaries import as_dictionary, codes
from truing.formats.evaluation import TableBatch, coordinates
from truing.formats.raw_tables import COORDINATES
from truing.formats.read import FileRows

if TYPE_CHECKING:
    from truing.stages.declaration import Progress


_ATTACHMENT_MM = 0.03
"""Standard deviation of a target at an attachment about its survey, because the platform deforms."""

_GIVES_WAY = 5e-5
"""Distance of a target from its survey in parts of the body's size: 10 K of aluminium over half of it."""

MOST_UNLABELLED = 3000
"""More points of one pose than anybody names by geometry: above, the file holds a surface."""

_SHOWN_RIVALS = 3


@dataclass(frozen=True)
class SurveyedBody:
    """Surveyed targets of one body: names (M), points (M, 3) in mm, and tolerance (M,) in mm of each."""

    names: tuple[str, ...]
    points: Array
    sigma_mm: Array


def surveyed_bodies(survey: pa.Table, point_mm: float) -> dict[str, SurveyedBody]:
    """Return the bodies of a survey table (columns of the artifact), with the noise that identification allows for."""
    body = np.asarray(survey.column("body").to_pylist(), dtype=object)
    target = np.asarray(survey.column("target").to_pylist(), dtype=object)
    points = np.column_stack([np.asarray(survey.column(name).to_pylist(), dtype=float) for name in COORDINATES])
    at_leg = np.array([leg is not None for leg in survey.column("leg").to_pylist()], dtype=bool)
    return {
        name: SurveyedBody(
            tuple(target[body == name]),
            points[body == name],
            _sigma(points[body == name], at_leg[body == name], point_mm),
        )
        for name in dict.fromkeys(body.tolist())
    }


def _sigma(points: Array, at_leg: Mask, point_mm: float) -> Array:
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    return np.sqrt(point_mm**2 + (_GIVES_WAY * size) ** 2 + np.where(at_leg, _ATTACHMENT_MM, 0.0) ** 2)


@dataclass(frozen=True)
class _Cloud:
    """All held points (N, 3), mm, and the body and target (N,) of each; empty text until they are identified."""

    points: Array
    body: NDArray
    target: NDArray


@dataclass
class Unlabelled:
    """Points without target names: held until all files are read, because a pose may be spread over files."""

    parts: list[tuple[FileRows, TableBatch]] = field(default_factory=list)
    left_out: Counter[tuple[str, str]] = field(default_factory=Counter)
    refused: dict[str, str] = field(default_factory=dict)
    labelled: set[str] = field(default_factory=set)
    too_many: dict[str, int] = field(default_factory=dict)

    def add(self, file: FileRows, batch: TableBatch) -> None:
        """Hold a batch of points that has no target column."""
        self.parts.append((file, batch))

    def identified_batches(
        self, survey: Mapping[str, SurveyedBody], point_mm: float, progress: Progress
    ) -> Iterator[tuple[FileRows, TableBatch]]:
        """Yield the held batches with body and target, without points that were not identified."""
        pose = _joined_texts([batch.columns["pose"] for _, batch in self.parts])
        given_texts = _joined_texts([_bodies(batch) for _, batch in self.parts])
        points = np.concatenate([coordinates(batch) for _, batch in self.parts])
        cloud = _Cloud(points, *(np.full(len(pose), "", dtype=object) for _ in range(2)))
        groups = list(_groups(pose, given_texts))
        for done, (name, of_body, rows) in enumerate(groups):
            progress(done, len(groups), f"naming the points of pose {name}")
            if len(rows) > MOST_UNLABELLED:
                self.too_many[name] = len(rows)
                continue
            wanted = {of_body: survey[of_body]} if of_body in survey else {} if of_body else survey
            self._identify(name, wanted, cloud, rows, point_mm)
        yield from self._batches(cloud.body, cloud.target)

    def _identify(
        self, pose: str, survey: Mapping[str, SurveyedBody], cloud: _Cloud, rows: Index, point_mm: float
    ) -> None:
        """Write body and target of the points of one pose (``rows``) into the cloud, and note what was refused."""
        labelled = label_bodies(
            1e-3 * cloud.points[rows],
            {name: 1e-3 * known.points for name, known in survey.items()},
            1e-3 * point_mm,
            {name: known.names for name, known in survey.items()},
            survey_sigma={name: 1e-3 * known.sigma_mm for name, known in survey.items()},
        )
        for name, labelling in labelled.items():
            if labelling.status is LabellingStatus.TOO_FEW:
                continue
            if labelling.status is not LabellingStatus.OK:
                self.refused[name] = _refusal(labelling)
                self.left_out[(f"pose {pose}, {name}", self.refused[name])] += 0
                continue
            self.labelled.add(name)
            is_assigned = labelling.assignment >= 0
            cloud.body[rows[is_assigned]] = name
            cloud.target[rows[is_assigned]] = np.asarray(survey[name].names, dtype=object)[
                labelling.assignment[is_assigned]
            ]
        if nameless := int(np.count_nonzero(cloud.target[rows] == "")):
            self.left_out[(f"pose {pose}", "points without a name that fit no target of the survey")] += nameless

    def _batches(self, body: NDArray, target: NDArray) -> Iterator[tuple[FileRows, TableBatch]]:
        from truing.formats.dictionaries import strings

        start = 0
        for file, batch in self.parts:
            rows = slice(start, start + batch.rows)
            start += batch.rows
            keep = target[rows] != ""
            columns = {name: values.filter(keep) for name, values in batch.columns.items()}
            columns["body"] = strings(body[rows][keep]).dictionary_encode()
            columns["target"] = strings(target[rows][keep]).dictionary_encode()
            yield file, TableBatch(columns, batch.records[keep])

    def unnamed_bodies(self) -> dict[str, str]:
        """Return bodies that were identified in no pose, with the reason."""
        return {body: why for body, why in self.refused.items() if body not in self.labelled}


def _refusal(labelling: Labelling) -> str:
    rivals = ", ".join(rival.name for rival in labelling.rivals[:_SHOWN_RIVALS])
    text = f"names refused ({labelling.status.value})"
    return f"{text}; rivals: {rivals}. {labelling.remedy}" if rivals else f"{text}. {labelling.remedy}"


def _groups(pose: list[str], labels: list[str]) -> Iterator[tuple[str, str, Index]]:
    """Yield the rows identified together: of one pose, and of one body if the file gives it."""
    rows: dict[tuple[str, str], list[int]] = {}
    for row, key in enumerate(zip(pose, labels, strict=True)):
        rows.setdefault(key, []).append(row)
    for (name, body), numbers in rows.items():
        yield name, body, np.array(numbers)


def _joined_texts(columns: list[pa.Array]) -> list[str]:
    return [str(value) for column in columns for value in column.to_pylist()]


def _bodies(batch: TableBatch) -> pa.Array:
    if "body" in batch.columns:
        return as_dictionary(batch.columns["body"])
    return pa.array([""] * batch.rows)


def without_target(batch: TableBatch) -> Mask:
    """Return the mask of points without a name in a batch."""
    if "target" not in batch.columns:
        return np.ones(batch.rows, dtype=bool)
    column = batch.columns["target"]
    empty = np.array([not text for text in column.dictionary.to_pylist()], dtype=bool)
    return empty[codes(column)] if empty.any() else np.zeros(batch.rows, dtype=bool)


def rows_of(batch: TableBatch, keep: Mask) -> TableBatch:
    """Some rows of a batch."""
    columns = {name: values.filter(keep) for name, values in batch.columns.items()}
    return TableBatch(columns, batch.records[keep])
