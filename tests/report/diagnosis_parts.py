"""Parts of the diagnosis section one by one, so that a test draws only the figures it needs."""

from __future__ import annotations

import pandas as pd

from truing.report.diagnosis.adequacy import adequacy
from truing.report.diagnosis.assessed_causes import accepted_of, assessed_causes
from truing.report.diagnosis.detectable_sizes import hidden
from truing.report.diagnosis.evidence import evidence
from truing.report.diagnosis.gain import gain_section
from truing.report.diagnosis.next_measurements import requested_measurements
from truing.report.diagnosis.pulls import changes, pulls
from truing.report.diagnosis.section import diagnosis, sizes
from truing.report.page import ReportSection, all_of
from truing.report.section_verdict import SectionVerdict
from truing.report.verdict import section_verdicts

Frames = dict[str, pd.DataFrame]
PARTS = {
    "adequacy": adequacy,
    "evidence": lambda tables: evidence(assessed_causes(tables)),
    "gain": lambda tables: gain_section(assessed_causes(tables), tables),
    "sizes": lambda tables: sizes(accepted_of(assessed_causes(tables)), tables),
    "pulls": pulls,
    "hidden": lambda tables: hidden(assessed_causes(tables), tables),
    "next": lambda tables: requested_measurements(assessed_causes(tables), tables),
    "changes": changes,
}


def part_of(name: str, tables: Frames) -> ReportSection:
    """The part of that name."""
    part = PARTS[name](tables)
    assert part.id == name
    return part


def verdict_of(section: str, tables: Frames) -> SectionVerdict:
    """The row of the verdict that a section or a part has."""
    return section_verdicts(tables)["adequacy" if section == "gain" else section]


def state_of(section: str, tables: Frames) -> str:
    """State of a section or a part in the verdict."""
    return verdict_of(section, tables).state.value


def parts_of(tables: Frames) -> dict[str, ReportSection]:
    """The whole section and its parts by name."""
    section = diagnosis(tables)
    assert section is not None
    return {part.id: part for part in all_of([section])}


def text_of(section: ReportSection) -> str:
    """All that a section says outside its figures."""
    cells = [cell for listing in section.listings for line in listing.rows for cell in line]
    return " ".join([section.lead, *(words for _, words in section.statements), *cells])
