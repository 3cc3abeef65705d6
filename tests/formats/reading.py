"""Helpers of the tests of readers: a folder with files and a mapping, read as one table."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from truing.formats.faultlog import FaultLog
from truing.formats.raw_tables import (
    CAMERAS,
    CONFIGURATIONS,
    DISPLACEMENT,
    IMAGE_POINTS,
    INTERFEROMETER,
    LOADS_APART,
    POINTS,
    POSES,
    POSITIONING,
    QUADRATURE,
    SCALE_BARS,
    SCANS,
    SIGNALS,
    SURFACES,
    TARGETS,
)
from truing.formats.read import read_table
from truing.formats.source import CampaignFiles
from truing.schemas.campaign import read_campaign
from truing.schemas.faults import Fault

_OF_BENCHES = (DISPLACEMENT, INTERFEROMETER, SIGNALS, LOADS_APART, QUADRATURE, POSITIONING)
_ALL = (POINTS, POSES, TARGETS, CONFIGURATIONS, SCANS, SURFACES, *_OF_BENCHES, IMAGE_POINTS, CAMERAS, SCALE_BARS)
SHAPES = {shape.name: shape for shape in _ALL}


@dataclass(frozen=True)
class Reading:
    """A table as it was read: columns of Python values, the record of each row, and what was said."""

    columns: dict[str, list[Any]]
    records: list[int]
    faults: tuple[Fault, ...]
    left_out: Counter[str]

    @property
    def rows(self) -> list[dict[str, Any]]:
        return [dict(zip(self.columns, row, strict=True)) for row in zip(*self.columns.values(), strict=True)]


def read(folder: Path, table: str = "points", entries: Any = None, *, poses_as_text: bool = False) -> Reading:
    """Read a table of the campaign in a folder; ``entries`` is its [files.<table>]."""
    files = {} if entries is None else {"files": {table: entries}}
    campaign = read_campaign({"campaign": {"name": "c", "kind": "photogrammetry"}, **files})
    log = FaultLog()
    columns: dict[str, list[Any]] = {}
    records: list[int] = []
    left_out: Counter[str] = Counter()
    for _, batch in read_table(CampaignFiles(folder, campaign), SHAPES[table], log, poses_as_text=poses_as_text):
        for name in {**columns, **batch.columns}:
            added = batch.columns[name].to_pylist() if name in batch.columns else [None] * batch.rows
            columns[name] = columns.get(name, [None] * len(records)) + added
        records += batch.records.tolist()
        left_out += batch.left_out
    return Reading(columns, records, log.faults(), left_out)


def written(folder: Path, name: str, text: str, encoding: str = "utf-8") -> Path:
    """A file of this text, its line ends as they are."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode(encoding))
    return path
