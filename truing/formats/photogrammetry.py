"""Which reader reads a file of a photogrammetric program, and which tables such a file can be."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from truing.formats.raw import RawBatch, Unusable, Wanted
from truing.formats.source import RawFile

if TYPE_CHECKING:
    from truing.formats.colmap_network import Estimate

_POINTS = ("points", "targets", "resurveys")
OF_PHOTOGRAPHS: dict[str, tuple[str, ...]] = {
    "colmap": ("image_points", "cameras", *_POINTS),
    "photomodeler": ("image_points", "cameras", *_POINTS),
    "metashape xml": ("image_points", "cameras"),
    "phc": ("image_points",),
    "ior": ("cameras",),
    "scale": ("scale_bars",),
    "gsi": _POINTS,
}


def read_of_photographs(
    file_format: str, raw: RawFile, path: Path, wanted: Wanted, table: str, estimate: Estimate | None
) -> Iterator[RawBatch]:
    """The rows of ``table`` in a file, which lies at ``path`` without its compression; raises Unusable where it holds
    none."""
    tables = OF_PHOTOGRAPHS[file_format]
    if table not in tables:
        raise Unusable(f"a file of {table}: such a file is read as {' or '.join(tables)}")
    if file_format == "colmap":
        from truing.formats.colmap import read_colmap

        return read_colmap(path, wanted, table, raw.path, estimate)
    if file_format == "photomodeler":
        from truing.formats.photomodeler import read_photomodeler

        return read_photomodeler(path, wanted, table)
    if file_format == "metashape xml":
        from truing.formats.metashape_xml import read_metashape_xml

        return read_metashape_xml(path, wanted, table)
    if file_format == "gsi":
        from truing.formats.leica_gsi import read_gsi

        return read_gsi(path, wanted)
    from truing.formats.aicon import read_ior, read_phc, read_scale

    if file_format == "phc":
        return read_phc(raw, path, wanted)
    return read_ior(path, wanted) if file_format == "ior" else read_scale(path, wanted)
