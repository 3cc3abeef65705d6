"""Object points out of photographs as the points of a campaign: who belongs to which body, and who to none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.formats.dictionaries import strings
from truing.formats.evaluation import TableBatch
from truing.formats.faultlog import FaultLog
from truing.formats.read import FileRows
from truing.formats.source import RawFile
from truing.schemas.faults import Fault
from truing.schemas.mapping import FileMapping

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow as pa

FILE = "object_points.parquet"
ONE_BODY = "object"
"""What the body is called where targets name none and there is no survey to tell."""

OF_NO_BODY = "points of no body: ends of scale bars, or targets that no survey has"

Names = NDArray[np.object_]


@dataclass(frozen=True)
class AdjustedPoints:
    """The artifact object_points, ends (names of points) of scale bars, where the campaign lies, and names of boards,
    each of which is a body where there is no survey."""

    table: pa.Table
    ends: frozenset[str]
    folder: Path
    boards: tuple[str, ...] = ()

    def batches(
        self, surveyed: Mapping[str, Mapping[str, object]], bodies: tuple[str, ...], log: FaultLog
    ) -> Iterator[tuple[FileRows, TableBatch]]:
        """All points as one batch, without those of no body; surveyed: targets by body, bodies: all there may be."""
        body, target = (_texts(self.table, name) for name in ("body", "target"))
        point = _texts(self.table, "point")
        body, of_several = _bodies(body, target, surveyed, self.boards)
        for name in dict.fromkeys(target[of_several].tolist()):
            said = "one body whose survey has this target, or its body in image_targets or image_points"
            log.add(Fault(FILE, said, column="target", value=name))
        ends = np.array([name in self.ends for name in point], dtype=bool)
        foreign = np.array([bool(bodies) and name not in bodies for name in body], dtype=bool)
        unsurveyed = np.array([name not in surveyed for name in body], dtype=bool)
        nobody = (target != "") & ((body == "") | (ends & unsurveyed) | (foreign & unsurveyed))
        keep = np.flatnonzero(~nobody & ~of_several)
        left_out = Counter({OF_NO_BODY: int(nobody.sum())}) if nobody.any() else Counter()
        yield self._file(), TableBatch(self._columns(keep, body, target, point), keep, left_out=left_out)

    def _columns(self, keep: NDArray[np.int64], body: Names, target: Names, point: Names) -> dict[str, pa.Array]:
        import pyarrow as pa

        names = ("x_mm", "y_mm", "z_mm", "sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "corr_xy", "corr_xz", "corr_yz")
        columns = {name: self.table.column(name).combine_chunks().take(pa.array(keep)) for name in names}
        pose = self.table.column("pose").combine_chunks().take(pa.array(keep))
        columns["pose"] = pose.dictionary_encode() if pa.types.is_string(pose.type) else pose
        texts = {"body": body, "target": target, "point": point}
        return columns | {name: strings(values[keep].tolist()).dictionary_encode() for name, values in texts.items()}

    def _file(self) -> FileRows:
        return FileRows(RawFile(FILE, self.folder / FILE), FileMapping(path=FILE), "parquet")

    def as_text(self) -> AdjustedPoints:
        """The same with poses as text, as a table of configurations with any pose that is no number has them."""
        import pyarrow as pa

        place = self.table.column_names.index("pose")
        table = self.table.set_column(place, "pose", self.table.column("pose").cast(pa.string()))
        return AdjustedPoints(table, self.ends, self.folder, self.boards)


def _texts(table: pa.Table, name: str) -> Names:
    return np.array(table.column(name).to_pylist(), dtype=object)


def _bodies(
    body: Names, target: Names, surveyed: Mapping[str, Mapping[str, object]], boards: tuple[str, ...]
) -> tuple[Names, NDArray[np.bool_]]:
    """The body of each point, found by its target's name where it is not said, and which names several bodies have."""
    nameless = (body == "") & (target != "")
    if not surveyed:
        of_board = [name.rpartition("-")[0] for name in target]
        own = np.array([name if name in boards else ONE_BODY for name in of_board], dtype=object)
        return np.where(nameless, own, body), np.zeros(len(body), bool)
    of: dict[str, list[str]] = {}
    for name, targets in surveyed.items():
        for one in targets:
            of.setdefault(one, []).append(name)
    found = [of.get(one, []) if unknown else [] for one, unknown in zip(target, nameless, strict=True)]
    several = np.array([len(names) > 1 for names in found], dtype=bool)
    single = np.array([names[0] if len(names) == 1 else "" for names in found], dtype=object)
    return np.where(nameless, single, body), several
