"""What clauses on findings are put together from: sizes in handy units, the largest of several, how far things move."""

from __future__ import annotations

import re

from truing.report.diagnosis.effect_units import told_size
from truing.report.diagnosis.findings import reach_of, subject_words
from truing.report.diagnosis.judged import Judged, Size
from truing.report.numbers import rough

# A component that is smaller than this many of its standard deviations is not told.
_SURE = 2.0


def told(size: Size) -> str:
    """``0.210 ± 0.010 %``."""
    return told_size(size.name, size.value, size.sigma, size.unit)


def positive(size: Size) -> Size:
    """The size without its sign, where words tell that."""
    return Size(size.name, abs(size.number or 0.0), size.sigma, size.unit)


def largest(sizes: tuple[Size, ...]) -> Size | None:
    """The size that is farthest from nothing."""
    return max(sizes, key=lambda size: abs(size.number or 0.0), default=None)


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


def most(row: Judged, kind: str) -> str:
    """``0.21 ± 0.01 %``, or where several legs have their own, ``most leg 3 (0.21 ± 0.01 %)``."""
    sizes = row.sizes_of(kind)
    size = largest(sizes)
    if size is None:
        return ""
    return told(size) if len(sizes) == 1 else f"most {leg_of(size, row.subject)} ({told(size)})"


def by(words: str) -> str:
    """The words as they end a clause; nothing of nothing."""
    return "" if not words else f", {words}" if words.startswith("most ") else f", by {words}"


def moves(row: Judged) -> str:
    """``, by up to 12 um``: how far the effect moves what was measured, of its explanation."""
    found = reach_of(row.explanation)
    return f", by up to {rough(found[0])} {found[1]}" if found is not None else ""
