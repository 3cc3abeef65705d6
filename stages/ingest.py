"""Stage ingest: raw files as tables of the campaign, in standard units, checked against each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.formats.raw_tables import MEASURED_APART
from truing.formats.source import TABLES, CampaignFiles
from truing.schemas.faults import Fault
from truing.schemas.mechanism import COLUMNS_OF_AXES, NOISE_OF_ENCODERS
from truing.schemas.near_names import did_you_mean
from truing.stages.declaration import Outcome, Progress, Stage, registered

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

DECLARATION = Stage(
    name="ingest",
    reads=("object_points?", "point_correlations?", "scale_bars?"),
    leaves=(
        *(
            "survey?",
            "configurations?",
            "joints?",
            "distances?",
            "scans?",
            "measured_poses?",
            "observations?",
            "start?",
            "readings?",
            "signals?",
            "loads_joined?",
        ),
        *("quadrature?", "reading_corrections?", "positions?", "given_compliance?", "given_deformation?"),
        *("published?", "relabelled?", "resurveys?"),
        "exclusions",
    ),
    settings=(
        *("campaign.kind", "campaign.drives", "mechanism.type", "mechanism.legs", "mechanism.model"),
        *("mechanism.flexure", "mechanism.leg_tube", "load"),
        *(
            "mechanism.height_mm",
            "mechanism.elements",
            "mechanism.platform",
            "mechanism.base",
            *COLUMNS_OF_AXES,
            *NOISE_OF_ENCODERS,
            "loading",
        ),
        *("interferometer", "signals.sensitivity_mv_per_n", "signals.average_samples"),
        *("noise.point_mm", "noise.linear_um"),
        *("noise.angular_arcsec", "noise.displacement_mm", "noise.rotation_rad", "measurement.frame", "poses.euler"),
        *("bodies.reference", "photographs.boards", "renamed", "resurvey", "files", "workspace.joints"),
        *(f"mechanism.{key}" for key in ("dh", "screws", "home", "base", "tip", "joints", "closure")),
        *("mechanism.gear_orders", "mechanism.pitch_mm"),
    ),
    summary="reads the raw files, converts units and names, and rejects invalid data",
)
# What reads the files of a mechanism that is neither of legs nor a sensor on its bench, by its type.
OF_TYPES = {"axis": "truing.stages.ingestion.axis_rows"}


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress, source: CampaignFiles) -> Outcome:
    """Tables of the campaign from its raw files; raises CampaignFaults with all faults together.

    Observations are a stream, checked while it is read, so faults may come at its end.
    """
    from truing.formats.faultlog import FaultLog

    log = FaultLog()
    for table in (name for name in settings.files if name not in TABLES):
        hint = did_you_mean(table, TABLES) or f"; one of {', '.join(TABLES)}"
        log.add(Fault("campaign.toml", f"a known table{hint}", column=f"files.{table}"))
    if MEASURED_APART.name in settings.files and settings.mechanism.type != "axis":
        expected = '[mechanism] type = "axis": its rows alone are joined with those of another file'
        log.add(Fault("campaign.toml", expected, column=f"files.{MEASURED_APART.name}"))
    if (ingest_type := registered(OF_TYPES, settings)) is not None:
        outcome: Outcome = ingest_type.ingest(settings, source, log)
        return outcome
    if settings.mechanism.type == "chain":
        from truing.stages.ingestion.chain_campaign import ingest as ingest_chain

        return ingest_chain(tables, settings, source, log, progress)
    if settings.campaign.kind == "interferometer":
        from truing.stages.ingestion.loading_tables import ingest

        return ingest(settings, source, log)
    from truing.stages.ingestion.point_campaign import ingest_points

    return ingest_points(tables, settings, source, log, progress)
