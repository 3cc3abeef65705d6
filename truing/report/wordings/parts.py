"""What clauses on causes are put together from: sizes in handy units, the largest of several, how far things move."""

from __future__ import annotations

import re
from collections.abc import Iterable

from truing.report.diagnosis.effect_units import told_size
from truing.report.diagnosis.findings import subject_words
from truing.report.numbers import rough
from truing.report.wordings.claim import Claim, Size

# A component that is smaller than this many of its standard deviations is not told.
_SURE = 2.0
# How many sizes a clause tells one by one.
_TOLD = 3


def told(size: Size) -> str:
    """``0.210 ± 0.010 %``."""
    return told_size(size.name, size.value, size.sigma, size.unit)


def positive(size: Size) -> Size:
    """The size without its sign, where words tell that."""
    return Size(size.name, abs(size.number or 0.0), size.sigma, size.unit)


def largest(sizes: tuple[Size, ...]) -> Size | None:
    """The size that is farthest from nothing."""
    return max(sizes, key=lambda size: abs(size.number or 0.0), default=None)


def only(claim: Claim, kind: str) -> tuple[str, bool]:
    """The largest size of a kind without its sign, empty where there is none, and whether it is positive."""
    size = largest(claim.sizes_of(kind))
    return ("", True) if size is None else (told(positive(size)), (size.number or 0.0) > 0.0)


def sure_of(sizes: tuple[Size, ...]) -> list[Size]:
    """Sizes that are beyond two of their sigmas, the largest first; where none is, the largest alone."""
    known = [size for size in sizes if size.number is not None]
    sure = [size for size in known if size.sigma is None or abs(size.number or 0.0) > _SURE * size.sigma]
    alone = largest(tuple(known))
    return sorted(sure or ([alone] if alone else []), key=lambda size: -abs(size.number or 0.0))


def leg_of(size: Size, subject: str) -> str:
    """``leg 3``: whose parameter it is, by its suffix or by the subject."""
    numbered = re.search(r"_(\d+)$", size.name)
    return f"leg {numbered[1]}" if numbered else subject_words(subject)


def by_most(claim: Claim, kind: str) -> str:
    """``, by 0.21 ± 0.01 %``, or of several legs ``, most leg 3 (0.21 ± 0.01 %)``; nothing without a size."""
    sizes = claim.sizes_of(kind)
    size = largest(sizes)
    if size is None:
        return ""
    return f", by {told(size)}" if len(sizes) == 1 else f", most {leg_of(size, claim.subject)} ({told(size)})"


def by(words: str) -> str:
    """``, by 0.21 ± 0.01 %``; nothing of nothing."""
    return f", by {words}" if words else ""


def moves(claim: Claim) -> str:
    """``, by up to 12 um``: how far the effect moves what was measured."""
    return "" if claim.largest_motion is None else f", by up to {rough(claim.largest_motion)} {claim.unit}"


def with_sizes(said: str, claim: Claim) -> str:
    """A clause, and how large it is: its parameters, or where these are many, how far it moves what was measured."""
    if len(claim.sizes) > _TOLD and claim.largest_motion is not None:
        return said + moves(claim)
    sizes = ", ".join(f"{size.name} {told(size)}" for size in claim.sizes[:_TOLD])
    return f"{said}: {sizes}" if sizes else said


def listed(names: Iterable[object]) -> str:
    """``1``, ``1 and 4``, ``1, 4 and 10``."""
    *first, last = map(str, names)
    return f"{', '.join(first)} and {last}" if first else last
