"""The sections of a run's page in their order, and those that installed packages add.

A new section is a module with a function of the section's name, and a line in SECTIONS; that of a package is an entry
point (docs/own-section.md). The modules are imported when they draw.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from truing.report.column_heads import Head, term_head
from truing.report.page import FIRST_SCREEN, NO_FACTS, CampaignFacts, Depth, Listing, ReportSection
from truing.schemas.installed import with_installed
from truing.schemas.stage_cost import StageCost

if TYPE_CHECKING:
    from truing.report.section_verdict import SectionVerdict
    from truing.report.tables import Tables

ENTRY_POINTS = "truing.sections"


@dataclass(frozen=True)
class PageSection:
    """A section: its id, and the modules whose function of that name builds it; the first result is used.

    ``title``: heading of the note on why the section is missing; without a title, or if section ``instead`` is present,
    it is left out silently. ``bench``: True only for campaigns on a bench, False only for others. ``reads``: tables of
    its own.
    """

    name: str
    modules: tuple[str, ...]
    title: str = ""
    instead: str = ""
    bench: bool | None = None
    reads: tuple[str, ...] = ()


SECTIONS = (
    PageSection("diagnosis", ("truing.report.diagnosis.section",), "Diagnosis"),
    PageSection("stop", ("truing.report.stopping_section",)),
    PageSection("axis", ("truing.report.axis_page",)),
    PageSection(
        "chain",
        ("truing.report.chain_page",),
        reads=(
            *(
                "joints",
                "chain_parameters",
                "chain_inseparable",
                "joint_curves",
                "guideway_errors",
                "series_errors",
                "arm_accuracy",
            ),
            "motor_encoders",
        ),
    ),
    PageSection("measured", ("truing.report.measured_section",)),
    PageSection("frames", ("truing.report.scene.frames",)),
    PageSection("qa", ("truing.report.quality_section",), "Quality"),
    PageSection("photographs", ("truing.report.photographs.section",)),
    PageSection("displacement", ("truing.report.sensor.displacement",), "Displacement", "positioning", bench=True),
    PageSection("positioning", ("truing.report.sensor.positioning",)),
    PageSection("poses", ("truing.report.poses_section",), "Poses", bench=False),
    PageSection(
        "deformation", ("truing.report.deformation_section", "truing.report.sensor.deformation"), "Deformation"
    ),
    PageSection("tolerances", ("truing.report.sensor.tolerances",), bench=True),
    PageSection("neglected", ("truing.report.sensor.neglected",), bench=True, reads=("neglected", "own_weight")),
    PageSection(
        "calibration", ("truing.report.calibration.section", "truing.report.sensor.calibration"), "Calibration"
    ),
    PageSection("knowledge", ("truing.report.identifiability_section",)),
    PageSection("transfer", ("truing.report.transfer_section",), reads=("second_campaign_errors",)),
    PageSection("requirements", ("truing.report.calibration.requirements",), "Requirements"),
    PageSection("alike", ("truing.report.similar_numbers_section",)),
    PageSection("uncertainty", ("truing.report.uncertainty_section",)),
    PageSection("during", ("truing.report.events_section",)),
    PageSection("excluded", ("truing.report.exclusion_section",)),
)
# Tables that the page is made from, in the order in which it lists their origin.
_TABLES = """
observations survey configurations readings signals displacement run_terms scans exclusions exclusion_effects
diagnosis_left_out calibration_left_out calibration_kept relabelled resurveys likely_names repeats lack_of_fit
pose_repeatability qa
belonging
poses residuals reading_residuals deformation target_deformation deformation_models deformation_errors
simulated_deformation compliance axis_curves published_compared tolerance_errors tolerance_samples
quadrature reading_corrections positions positioning
calibration implicit_calibration correlations accuracy model_choice observability flexure_parameters
absorption requirements sensor_matrix
sensor_merit sensor_choice error_classes calibrations_compared diagnosis diagnosis_choices adequacy detectable pulls
pull_sums prediction reading_errors axis_errors next_poses next_loads changes uncertainty uncertainty_budget
object_points cameras camera_correlations determined_combinations
image_orientations image_residuals scale_bar_lengths bundle_statistics
"""


def page_sections() -> tuple[PageSection, ...]:
    """Return all sections in the order of the page: the project's own, then those of installed packages."""
    return tuple(with_installed(SECTIONS, ENTRY_POINTS, "section", lambda section: section.name).values())


# Ids of subsections.
_PARTS = """
adequacy evidence gain sizes pulls swallowed loads hidden next changes
uncertainty-pose uncertainty-calibration uncertainty-cause uncertainty-accuracy uncertainty-tip provenance glossary
"""


def section_names() -> tuple[str, ...]:
    """Return the ids of all sections and subsections that a page can have, first that of the first screen."""
    return tuple(dict.fromkeys([FIRST_SCREEN, *(section.name for section in page_sections()), *_PARTS.split()]))


def tables_read() -> tuple[str, ...]:
    """Return the artifacts that the page is made from, in the order in which it lists their origin."""
    return tuple(dict.fromkeys([*_TABLES.split(), *(name for section in page_sections() for name in section.reads)]))


def build_sections(
    tables: Tables, provenance: Mapping[str, Mapping[str, str]], about: CampaignFacts = NO_FACTS
) -> list[ReportSection]:
    """Return all sections in order; a bench has displacements instead of poses.

    ``tables`` by artifact name, and ``shape`` (body, target, x_mm, y_mm, z_mm, leg): places of each body's targets.
    ``provenance``: metadata of each artifact; ``about``: what no table holds.
    """
    from truing.report.figure_style import figure_template
    from truing.report.glossary_section import with_reference
    from truing.report.section_verdict import verdict_rows
    from truing.report.tables import is_bench, untested_sections
    from truing.report.verdict import with_verdict

    bench = is_bench(tables) or "displacement" in tables or ("positioning" in tables and "configurations" not in tables)
    absent = untested_sections(tables)
    wanted = [
        page_section
        for page_section in page_sections()
        if page_section.bench in (None, bench) and page_section.name not in absent
    ]
    with figure_template():
        drawn = {section.name: _drawn(section, tables) for section in wanted}
    shown = [drawn[section.name] or _note_for_missing(section, drawn, tables) for section in wanted]
    rows = verdict_rows(with_verdict(tables))
    marked = [*(_marked(section, rows) for section in shown if section is not None), _provenance(provenance, about)]
    reference = with_reference(marked, bench=bench, above=_ON_FIRST_SCREEN)
    return sorted(map(_at_depth, reference), key=_is_behind)


_ON_FIRST_SCREEN = ("rms", "noise floor")  # terms that it explains
# Sections and subsections that a reader sees at once, each with the number of its figures that are shown.
_ESSENTIAL = {"gain": 1, "axis": 1, "positioning": 1, "requirements": 1} | dict.fromkeys(
    ("diagnosis", "adequacy", "next", "changes", "stop", "calibration", "transfer", "qa"), 0
)


def _at_depth(section: ReportSection) -> ReportSection:
    """Return a section with its depth; one without figures, tables and subsections has nothing to open."""
    if section.id not in _ESSENTIAL:
        opens = bool(section.figures or section.listings or section.parts)
        return replace(section, depth=Depth.APPENDIX if opens else Depth.WHOLE)
    parts = tuple(sorted(map(_at_depth, section.parts), key=_is_behind))
    return replace(section, parts=parts, depth=Depth.ESSENTIAL, front=_ESSENTIAL[section.id])


def _is_behind(section: ReportSection) -> bool:
    """True if a section comes after the essential ones."""
    return section.depth != Depth.ESSENTIAL


# Ids of sections and subsections whose rows in the verdict have another name.
_ROWS = {"qa": ("belonging", "quality"), "gain": ("adequacy",)}


def _marked(section: ReportSection, rows: Mapping[str, SectionVerdict]) -> ReportSection:
    """Return a section and its subsections with their marks from the verdict, or its own mark where it has none."""
    section_rows = [rows[name] for name in _ROWS.get(section.id, (section.id,)) if name in rows]
    parts = tuple(_marked(part, rows) for part in section.parts)
    if not section_rows:
        return replace(section, parts=parts)
    worst = min(section_rows, key=lambda verdict: _GRAVITY.index(verdict.state.value))
    return replace(section, parts=parts, state="not tested" if worst.mark == "none" else worst.mark)


_GRAVITY = ("fails", "attention", "ok", "not tested")


def _drawn(section: PageSection, tables: Tables) -> ReportSection | None:
    for module in section.modules:
        draw: Callable[[Tables], ReportSection | None] = getattr(importlib.import_module(module), section.name)
        if (figure := draw(tables)) is not None:
            return figure
    return None


def _note_for_missing(
    section: PageSection, drawn: Mapping[str, ReportSection | None], tables: Tables
) -> ReportSection | None:
    """Return a note in place of a section whose tables are missing; None without a note."""
    from truing.report.reasons import why_absent

    if not section.title or drawn.get(section.instead) is not None:
        return None
    return ReportSection(section.name, section.title, why_absent(section.name, tables), state="not evaluated")


_ARTIFACT_HEADS = (
    term_head("artifact"),
    term_head("stage"),
    Head("version", "Version of truing that wrote it."),
    Head("digest", "First 16 digits of the SHA-256 of inputs, settings and source of the stage."),
)


_FILE_HEADS = (
    Head("file", "Raw file in the folder of the campaign."),
    Head("bytes", "Size of the file."),
    Head("last change (UTC)", "When the file was last written, by the file system."),
    Head("lines", "Number of lines of a text file, heads and comments included."),
    Head("SHA-256", "Digest of the file's content; equal files have equal digests."),
)
_COST_HEADS = (
    term_head("stage"),
    Head("time (s)", "Time that the stage took when it last ran; a stage that is up to date does not run again."),
    Head("memory (MB)", "Largest memory of the main process during the stage; – where the system does not say it."),
    Head("processes", "Number of processes that the stage could use."),
)
_PERSON_HEADS = (
    Head("name", "Person as [[certificate.persons]] names it."),
    Head("role", "Role of the person in the laboratory."),
)
_OPEN = 12  # raw files that are not folded


def _cost(cost: StageCost) -> tuple[str, ...]:
    """Return the cells with time and memory of a stage."""
    memory = "–" if cost.memory_bytes is None else f"{cost.memory_bytes / 1e6:,.0f}"
    return cost.stage, f"{cost.seconds:.2f}", memory, str(cost.workers)


def _provenance(provenance: Mapping[str, Mapping[str, str]], about: CampaignFacts) -> ReportSection:
    """Return the artifacts that the page was made from, with the digest of their inputs, settings and software."""
    rows = tuple(
        (name, facts.get("stage", ""), facts.get("software_version", ""), facts.get("digest", "")[:16])
        for name, facts in provenance.items()
        if facts  # those that this stage makes carry none yet
    )
    lead = "The digest of an artifact covers its inputs, its settings and the source code that made it."
    listings = (
        Listing(
            (Head("key of campaign.toml", "Key by its section."), Head("value", "Declared value.")),
            about.declared,
            caption="Declared settings",
        ),
        Listing(
            (
                Head("software", "Program or library that computed."),
                Head("version", "Version of this program or library."),
            ),
            about.software,
            caption="Software that made this page",
        ),
        Listing(_COST_HEADS, tuple(map(_cost, about.costs)), caption="Run: time and memory of each stage"),
        Listing(_ARTIFACT_HEADS, rows, caption="Artifacts"),
        Listing(
            _FILE_HEADS,
            tuple(
                (
                    file.name,
                    f"{file.size:,}",
                    file.changed,
                    "" if file.lines is None else f"{file.lines:,}",
                    file.digest,
                )
                for file in about.files
            ),
            caption=f"Raw files ({len(about.files):,})",
            folded=len(about.files) > _OPEN,
        ),
        Listing(_PERSON_HEADS, about.persons, caption="Responsible persons"),
    )
    return ReportSection(
        "provenance", "Provenance", lead, listings=tuple(listing for listing in listings if listing.rows)
    )
