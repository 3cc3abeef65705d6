"""Comments of a person, each in its section of the page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from truing.report.page import FIRST_SCREEN, ReportSection, all_of

_REST = "Comments on sections that this run does not have."


def with_comments(sections: Sequence[ReportSection], comments: Iterable[tuple[str, str]]) -> list[ReportSection]:
    """Return the sections with the comments (id of a section, text) of each; those of absent ones come last.
    The first screen is no section: the page shows its comments itself."""
    given = list(comments)
    known = {FIRST_SCREEN, *(section.id for section in all_of(sections))}
    unplaced = tuple(f"{name}: {text}" for name, text in given if name not in known)
    last = [ReportSection("comments", "Comments", _REST, comments=unplaced)] if unplaced else []
    return [*(_commented(section, given) for section in sections), *last]


def _commented(section: ReportSection, comments: list[tuple[str, str]]) -> ReportSection:
    texts = tuple(text for name, text in comments if name == section.id)
    return replace(section, comments=texts, parts=tuple(_commented(part, comments) for part in section.parts))
