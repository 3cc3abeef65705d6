"""Report: everything the run knows, on one page that opens without a network."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign

DECLARATION = Stage(
    name="report",
    reads=(
        "observations?",
        "survey?",
        "configurations?",
        "readings?",
        "signals?",
        "displacement?",
        "run_terms?",
        "scans?",
        "exclusions?",
        "qa?",
        "poses?",
        "residuals?",
        "reading_residuals?",
        "deformation?",
        "target_deformation?",
        "deformation_models?",
        "deformation_errors?",
        "compliance?",
        "axis_curves?",
        "quadrature?",
        "positions?",
        "positioning?",
        "calibration?",
        "implicit_calibration?",
        "correlations?",
        "accuracy?",
        "model_choice?",
        "observability?",
        "absorption?",
        "requirements?",
        "sensor_matrix?",
        "sensor_merit?",
        "sensor_choice?",
        "error_classes?",
        "diagnosis?",
        "detectable?",
        "pulls?",
        "pull_sums?",
        "prediction?",
        "reading_errors?",
        "next_poses?",
        "changes?",
    ),
    leaves=("report",),
    settings=("campaign.name",),
    summary="one self-contained page with figures, findings and exclusions",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Render the page."""
    from stages.measured_shape import target_places
    from truing.report.head import build_head
    from truing.report.page import all_of
    from truing.report.rendering.render import render_page
    from truing.report.sections import build_sections
    from truing.report.tables import SAID

    frames = {name: table.to_pandas() for name, table in tables.items()}
    for name, table in tables.items():
        frames[name].attrs[SAID] = _provenance(table).get("said", "")
    places = target_places(frames)
    if places is not None:
        frames["shape"] = places
    sections = build_sections(frames, {name: _provenance(table) for name, table in tables.items()})
    progress(1, 2, "figures")
    page = render_page(build_head(settings.campaign.name, frames), sections)
    drawn = sum(len(section.figures) for section in all_of(sections))
    read = f"{len(tables)} artifacts"
    return Outcome(
        {"report": page}, read, "nothing", f"{len(sections)} sections, {drawn} figures, {len(page) / 1e6:.1f} MB"
    )


def _provenance(table: pa.Table) -> dict[str, str]:
    metadata = table.schema.metadata or {}
    prefix = b"truing."
    return {k[len(prefix) :].decode(): v.decode() for k, v in metadata.items() if k.startswith(prefix)}
