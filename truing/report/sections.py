"""The sections of a run's page in the order in which they are read; one without its table says so."""

from __future__ import annotations

from collections.abc import Mapping

from truing.report.calibration.requirement_section import requirements
from truing.report.calibration.section import calibration
from truing.report.deformation.section import deformation
from truing.report.diagnosis.section import diagnosis
from truing.report.exclusion_section import excluded
from truing.report.knowledge.section import knowledge
from truing.report.measured_section import measured
from truing.report.page import Listing, Section
from truing.report.poses.section import poses
from truing.report.quality_section import quality
from truing.report.sensor.calibration import sensor_calibration
from truing.report.sensor.deformation import load_deformation
from truing.report.sensor.displacement import displacement
from truing.report.sensor.positioning import positioning
from truing.report.tables import Tables


def build_sections(tables: Tables, provenance: Mapping[str, Mapping[str, str]]) -> list[Section]:
    """Every section that this kind of campaign has.

    ``tables`` by artifact name, and ``shape`` (body, target, x_mm, y_mm, z_mm, leg): where each body's targets sit.
    ``provenance``: the metadata of each artifact.
    """
    parts = (
        *(diagnosis, calibration, sensor_calibration, knowledge, requirements, measured, quality),
        *(poses, displacement, deformation, load_deformation, positioning, excluded),
    )
    drawn = (part(tables) for part in parts)
    return [*(section for section in drawn if section is not None), _provenance(provenance)]


def _provenance(provenance: Mapping[str, Mapping[str, str]]) -> Section:
    """Which artifacts the page was made from, with the digest of everything each was made of."""
    rows = tuple(
        (name, facts.get("stage", ""), facts.get("software_version", ""), facts.get("digest", "")[:16])
        for name, facts in provenance.items()
    )
    lead = "The digest of an artifact covers its inputs, its settings and the source that made it."
    listing = Listing(("artifact", "stage", "version", "digest"), rows)
    return Section("provenance", "Provenance", lead, listings=(listing,))
