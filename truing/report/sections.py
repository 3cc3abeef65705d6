"""The sections of a run's page in the order in which they are read; one that was not evaluated says so, and why."""

from __future__ import annotations

from collections.abc import Mapping

from truing.report.axis_page import axis
from truing.report.calibration.requirement_section import requirements
from truing.report.calibration.section import calibration
from truing.report.deformation.section import deformation
from truing.report.diagnosis.section import diagnosis
from truing.report.during_section import during
from truing.report.exclusion_section import excluded
from truing.report.figure_style import common_look
from truing.report.knowledge.section import knowledge
from truing.report.load_steps import is_bench
from truing.report.measured_section import measured
from truing.report.page import Listing, Section
from truing.report.photographs.section import photographs
from truing.report.poses.section import poses
from truing.report.quality_section import quality
from truing.report.reasons import why_absent
from truing.report.sensor.calibration import sensor_calibration
from truing.report.sensor.deformation import load_deformation
from truing.report.sensor.displacement import displacement
from truing.report.sensor.positioning import positioning
from truing.report.tables import Tables
from truing.report.uncertainty.section import uncertainty

_OF_BENCHES = ("displacement", "positioning")


@common_look()
def build_sections(tables: Tables, provenance: Mapping[str, Mapping[str, str]]) -> list[Section]:
    """Every section, in one order for every kind of campaign; a bench has displacements where others have poses.

    ``tables`` by artifact name, and ``shape`` (body, target, x_mm, y_mm, z_mm, leg): where each body's targets sit.
    ``provenance``: the metadata of each artifact.
    """
    of_axis = axis(tables)
    bench = is_bench(tables) or any(name in tables for name in _OF_BENCHES)
    drawn = [
        diagnosis(tables) or _absent("diagnosis", "Diagnosis", tables),
        of_axis,
        None if of_axis else measured(tables),
        quality(tables) or _absent("qa", "Quality", tables),
        photographs(tables),
        *(_placed(tables) if bench else [poses(tables) or _absent("poses", "Poses", tables)]),
        deformation(tables) or load_deformation(tables) or _absent("deformation", "Deformation", tables),
        calibration(tables) or sensor_calibration(tables) or _absent("calibration", "Calibration", tables),
        knowledge(tables),
        requirements(tables) or _absent("requirements", "Requirements", tables),
        uncertainty(tables),
        during(tables),
        excluded(tables),
        _provenance(provenance),
    ]
    return [section for section in drawn if section is not None]


def _placed(tables: Tables) -> list[Section | None]:
    """How a platform, or an axis, moved on a bench."""
    moved, along = displacement(tables), positioning(tables)
    return [moved or (None if along else _absent("displacement", "Displacement", tables)), along]


def _absent(name: str, title: str, tables: Tables) -> Section:
    """A section whose tables no stage left."""
    return Section(name, title, why_absent(name, tables), state="not evaluated")


def _provenance(provenance: Mapping[str, Mapping[str, str]]) -> Section:
    """Which artifacts the page was made from, with the digest of everything each was made of."""
    rows = tuple(
        (name, facts.get("stage", ""), facts.get("software_version", ""), facts.get("digest", "")[:16])
        for name, facts in provenance.items()
    )
    lead = "The digest of an artifact covers its inputs, its settings and the source that made it."
    listing = Listing(("artifact", "stage", "version", "digest"), rows)
    return Section("provenance", "Provenance", lead, listings=(listing,))
