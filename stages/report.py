"""Stage report: verdict on the campaign, and all results on one page that needs no network."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.report.numbers import count_text
from truing.report.sections import tables_read
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from truing.formats.source import CampaignFiles
    from truing.schemas.campaign import Campaign

DECLARATION = Stage(
    name="report",
    reads=tuple(f"{table}?" for table in tables_read()),
    leaves=("frames?", "verdict", "next_measurements", "report"),
    settings=(
        *(f"campaign.{key}" for key in ("name", "title", "laboratory", "customer", "operator", "logo")),
        *(f"certificate.{key}" for key in ("begin", "end", "laboratory", "customer", "item", "equipment", "persons")),
        *("mechanism.type", "mechanism.legs", "mechanism.height_mm"),
        *(
            "comment",
            "noise",
            "measurement",
            "bodies",
            "requirement",
            "diagnosis",
            "interferometer",
            "signals",
            "photographs",
        ),
    ),
    summary="the verdict, and one self-contained page with figures, findings and exclusions",
)


def run(
    tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress, files: CampaignFiles | None = None
) -> Outcome:
    """Give the verdict, and render the page that reads it; ``files``: for a logo, and the digests of raw files."""
    from truing.report.page import all_of
    from truing.report.rendering.render import render_page
    from truing.report.verdict import gates
    from truing.runs.page_parts import next_measurements_table, page_parts, verdict_table
    from truing.stages.common.campaign_facts import campaign_facts
    from truing.stages.common.frames_of_machine import machine_frames

    frames = machine_frames(settings, tables.get("poses"))
    made = {} if frames is None else {"frames": frames}
    verdict = verdict_table(tables)
    all_tables = {**tables, **made, "verdict": verdict}
    head, sections = page_parts(
        settings.campaign.name,
        all_tables,
        _joints(settings),
        _declared_noise(settings),
        campaign_facts(settings, files),
    )
    progress(1, 2, "figures")
    page = render_page(head, sections)
    drawn = sum(len(section.figures) for section in all_of(sections))
    read, size = (
        f"{len(tables)} artifacts",
        f"{count_text(len(sections), 'section')}, {count_text(drawn, 'figure')}, {len(page) / 1e6:.1f} MB",
    )
    left = {**made, "verdict": verdict, "next_measurements": next_measurements_table(all_tables), "report": page}
    return Outcome(left, read, "nothing", size, tuple(gates(verdict.to_pylist())))


def _declared_noise(settings: Campaign) -> pd.DataFrame:
    """One sigma of signals, NaN where none is declared."""
    import pandas

    return pandas.DataFrame({"signal_mv": [settings.noise.signal_mv]}, dtype=float)


def _joints(settings: Campaign) -> pd.DataFrame | None:
    """Columns leg, ax_mm .. az_mm, bx_mm .. bz_mm of a sensor, in its unloaded platform's frame; None of others."""
    legs, height_mm = (getattr(settings.mechanism, name, None) for name in ("legs", "height_mm"))
    if legs is None or height_mm is None:
        return None
    import pandas

    rows = [(k, leg.B_mm[0], leg.B_mm[1], leg.B_mm[2] - height_mm, *leg.b_mm) for k, leg in enumerate(legs, 1)]
    return pandas.DataFrame(rows, columns=["leg", *(f"{joint}{axis}_mm" for joint in "ab" for axis in "xyz")])
