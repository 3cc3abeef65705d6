"""Reference of a page that names checks and causes: these, its columns and its terms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from truing.report.column_heads import CAUSE, Head, schema_head
from truing.report.diagnosis.assessed_causes import NOISE_ALONE
from truing.report.page import Listing, ReportSection, all_of
from truing.report.reference import defined, reference
from truing.report.wordings.catalogue import WORDINGS, cause_meaning, cause_words
from truing.report.wordings.error_classes import ERROR_CLASSES
from truing.schemas.quality_check import QualityCheck
from truing.schemas.quality_checks import checks_of

_WHAT_IT_IS = Head("what it is", "Effect in general, without its size in this campaign.")
_CHECK_HEADS = (
    schema_head("check"),
    Head("what it asks", "Question of the check to the data."),
    Head("why", "Reason why the answer matters for the results."),
    Head("warns or fails", "Conditions of a warning and of a failure, by default; [qa.limits] may set other limits."),
    Head("what to do", "Remedy if the check warns or fails."),
)
_CAUSE_HEADS = (CAUSE, _WHAT_IT_IS, Head("id", "Name of the cause in campaign.toml and in the artifacts."))
_CLASS_HEADS = (Head("class", "Name of the error in laboratory terms."), Head("what it is", "Definition of the error."))


def with_reference(
    sections: Sequence[ReportSection], *, bench: bool = False, above: Sequence[str] = ()
) -> list[ReportSection]:
    """Return the sections of a page, followed by the explanations of all names in them; see ``glossary_section``."""
    explained = glossary_section(sections, bench=bench, above=above)
    return [*sections, *([explained] if explained else [])]


def glossary_section(
    sections: Sequence[ReportSection], *, bench: bool = False, above: Sequence[str] = ()
) -> ReportSection | None:
    """Return the explanations of terms in tables and captions of the sections; None where they name nothing.

    ``bench``: checks of both kinds of campaign are explained as for a bench; ``above``: captions before the first
    section.
    """
    every = [listing for section in all_of(sections) for listing in section.listings]
    checks = checks_of("interferometer" if bench else "photogrammetry")
    causes = {cause_words(cause): (cause_meaning(cause), cause) for cause in WORDINGS}
    causes |= {NOISE_ALONE: ("The measurements scatter otherwise than declared, without a mean effect.", "unexplained")}
    listings = [
        defined(
            "check", _CHECK_HEADS, {name: _of_check(check) for name, check in checks.items()}, named_in(every, "check")
        ),
        defined("cause", _CAUSE_HEADS, causes, named_in(every, "cause")),
        defined(
            "class", _CLASS_HEADS, {name: (words,) for name, words in ERROR_CLASSES.items()}, named_in(every, "class")
        ),
    ]
    return reference(sections, listings, above)


def _of_check(check: QualityCheck) -> tuple[str, ...]:
    """Return question, reason, conditions and remedy of a check."""
    limits = (("warns", check.criterion.warns), ("fails", check.criterion.fails))
    criterion_quantity = getattr(check.criterion, "of", "")
    limits_text = "; ".join(f"{verb}: {words}" for verb, words in limits if words)
    limits_text = f"{criterion_quantity}: {limits_text}" if criterion_quantity else limits_text
    return tuple(words.replace("`", "") for words in (check.question, check.why, limits_text, check.to_do))


def named_in(listings: Iterable[Listing], head: str) -> set[str]:
    """Return the cells of columns with this head."""
    columns = ((listing, listing.heads.index(head)) for listing in listings if head in listing.heads)
    return {row[k] for listing, k in columns for row in listing.rows}
