"""The section of the diagnosis, the heart of the page: what the simulation gets wrong, how sure, and what it costs."""

from __future__ import annotations

from truing.report.calibration.calibrations import shown_calibration
from truing.report.diagnosis.changes import changes
from truing.report.diagnosis.evidence import evidence
from truing.report.diagnosis.gain import gained
from truing.report.diagnosis.headline import clause
from truing.report.diagnosis.hidden import hidden
from truing.report.diagnosis.judged import RIVAL, Judged, found_of, judged
from truing.report.diagnosis.next_configurations import following
from truing.report.diagnosis.pulls import pulls
from truing.report.diagnosis.sizes import sizes
from truing.report.diagnosis.unwritten_loads import unwritten_loads
from truing.report.diagnosis.words import certainty, counted, lower
from truing.report.knowledge.absorption_words import absorbed_by, swallowed
from truing.report.numbers import printed
from truing.report.page import Listing, Section
from truing.report.reasons import why_no_diagnosis
from truing.report.tables import Tables, filled

_TITLE = "Diagnosis"


def diagnosis(tables: Tables) -> Section | None:
    """What was found and how sure, the evidence, the gain, the geometry, what stays hidden, and what to do next."""
    if "diagnosis" not in tables:
        return None
    rows = judged(tables)
    if not rows:
        why = why_no_diagnosis(tables)
        return Section("diagnosis", _TITLE, why[:1].upper() + why[1:], state="not evaluated")
    found = found_of(rows)
    rivals = [row for row in rows if row.verdict == RIVAL]
    told = [("warn" if row.is_noise else "found", _finding(row, tables)) for row in found]
    told += [("warn", f"As good, and not to be told from it: {lower(_finding(row, tables))}") for row in rivals]
    listings = tuple(listing for listing in (_words([*found, *rivals]),) if listing.rows)
    parts = tuple(part for part in _parts(rows, found, tables) if part is not None)
    state = "fail" if any(not row.is_noise for row in found) else "pass"
    return Section("diagnosis", _TITLE, counted(rows, tables), (), listings, state, tuple(told), parts)


def _parts(rows: list[Judged], found: list[Judged], tables: Tables) -> list[Section | None]:
    return [
        evidence(rows),
        gained(rows, tables),
        sizes(found) if found else None,
        pulls(tables),
        _swallowed(tables) if any(row.cause.startswith("platform-deformation") for row in found) else None,
        unwritten_loads(rows, tables),
        hidden(rows, tables),
        following(rows, tables),
        changes(tables),
    ]


def _finding(row: Judged, tables: Tables) -> str:
    """What, where, how large; then how sure."""
    sure = certainty(row)
    return f"{clause(row, tables)}. {sure[:1].upper()}{sure[1:]}." if sure else f"{clause(row, tables)}."


def _words(rows: list[Judged]) -> Listing:
    """The full sentences, as the tables hold them."""
    told = tuple((row.name, printed(row.explanation), printed(row.then)) for row in rows)
    heads = ("cause", "what the data say", "next measurement")
    return Listing(heads, told, (), "In full, as diagnosis.parquet has it", True, "diagnosis.parquet")


def _swallowed(tables: Tables) -> Section | None:
    """Where the absorption map stands, and what it says in a sentence."""
    fitted = filled(tables, "calibration")
    said = swallowed(absorbed_by(tables, shown_calibration(tables, fitted))) if fitted is not None else ""
    if not said:
        return None
    see = (("knowledge", "The absorption map, under What can be known."),)
    return Section("swallowed", "What parameters swallow where it is left out", said, see=see)
