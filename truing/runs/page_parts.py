"""What the page of a run consists of, from its tables alone: the same for the report stage and for a notebook."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.runs.body_motions import body_motions
from truing.runs.target_places import target_places

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from truing.report.page import Head, Section

_PREFIX = b"truing."


def provenance_of(table: pa.Table) -> dict[str, str]:
    """Return what a table carries about its origin: stage, digest, version, campaign, units, what its stage said."""
    metadata = table.schema.metadata or {}
    return {k[len(_PREFIX) :].decode(): v.decode() for k, v in metadata.items() if k.startswith(_PREFIX)}


def page_parts(
    campaign: str,
    tables: Mapping[str, pa.Table],
    legs: pd.DataFrame | None = None,
    declared_noise: pd.DataFrame | None = None,
) -> tuple[Head, list[Section]]:
    """Return the head and the sections of the page for tables by artifact name.

    ``legs`` (leg, ax_mm .. az_mm, bx_mm .. bz_mm): joints of a sensor in its platform's frame, and ``declared_noise``
    (signal_mv, NaN where none is declared): what no table holds.
    """
    from truing.report.head import build_head
    from truing.report.sections import build_sections
    from truing.report.tables import WHY_NOT

    provenance = {name: provenance_of(table) for name, table in tables.items()}
    frames = {name: table.to_pandas() for name, table in tables.items()}
    for name, frame in frames.items():  # nothing else: pandas copies attributes with every step
        frame.attrs[WHY_NOT] = provenance[name].get(WHY_NOT, "")
    places = target_places(frames)
    if places is not None:
        frames["shape"] = places
    motions = body_motions(frames)
    if motions is not None:
        frames["motions"] = motions
    if legs is not None:
        frames["legs"] = legs
    if declared_noise is not None:
        frames["declared_noise"] = declared_noise
    return build_head(campaign, frames), build_sections(frames, provenance)
