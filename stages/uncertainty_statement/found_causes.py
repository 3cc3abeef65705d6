"""Causes that the diagnosis found, of which results of other fits may know nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.simulation.catalogue import catalogue, catalogue_of_rays, of_photographed_points
from truing.simulation.cause import Step

if TYPE_CHECKING:
    import pyarrow as pa

DEFORMATION = "platform-deformation"


def found_causes(tables: Mapping[str, pa.Table]) -> dict[str, str]:
    """The causes that were found, in words, with their ids."""
    table = tables.get("diagnosis")
    rows = [row for row in table.to_pylist() if row["verdict"] == "found"] if table is not None else []
    return {f"{row['cause']} {row['subject'] or ''}".strip(): row["cause"] for row in rows}


def of_instrument(cause: str) -> bool:
    """Whether a cause, by its id, changes what is recorded of points, and so every pose of them."""
    known = (catalogue() | of_photographed_points() | catalogue_of_rays()).get(cause)
    return known is not None and known.step is Step.INSTRUMENT
