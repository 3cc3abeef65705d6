"""Claim on a cause with its settings and sizes, and building blocks of clauses."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from truing.report.diagnosis.effect_units import size_text, stem
from truing.report.diagnosis.findings import subject_words
from truing.report.numbers import rough

# Components smaller than this many standard deviations are left out.
SURE = 2.0
# Setting of an accepted cause with the earliest and the latest possible onset (95 %).
ONSET_BETWEEN = "onset_between"
# Number of sizes that a clause gives one by one.
_MOST_SHOWN = 3


@dataclass(frozen=True)
class ParameterSize:
    """Parameter of a cause: value, one sigma (None for text and counts) and unit, as in the table."""

    name: str
    value: Any
    sigma: float | None
    unit: str

    @property
    def number(self) -> float | None:
        """Value, if it is a number."""
        plain = isinstance(self.value, (int, float)) and not isinstance(self.value, bool)
        return float(self.value) if plain and math.isfinite(self.value) else None


@dataclass(frozen=True)
class Reach:
    """Largest shift in um, and the legs (from 1) that it concerns: one, or two relative to each other.

    ``sigma`` in um, for uncorrelated parameters, as the table of the diagnosis holds no correlations.
    """

    largest: float
    legs: tuple[int, ...]
    sigma: float | None = None


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One candidate cause from the tables.

    ``is_negative``: all fitted sizes are, for a clause that gives none of them. ``settings``: fields of the cause, and
    the ``step`` of the chain at which it acts. ``words``: clause of a cause from a package. ``largest_motion``, in
    ``unit``: largest change of any measured quantity; ``reach``: largest shift of the attachments.
    """

    cause: str
    subject: str = ""
    sizes: tuple[ParameterSize, ...] = ()
    follows: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    words: str = ""
    largest_motion: float | None = None
    unit: str = ""
    reach: Reach | None = None
    is_negative: bool = False

    def size(self, name: str) -> ParameterSize | None:
        """Return the parameter of that name."""
        return next((size for size in self.sizes if size.name == name), None)

    def sizes_of(self, kind: str) -> tuple[ParameterSize, ...]:
        """Return the parameters of a kind, one per leg where each leg has its own."""
        return tuple(size for size in self.sizes if stem(size.name) == kind and size.number is not None)

    def fact(self, name: str) -> Any:
        """Return a setting, or the parameter of that name where the table holds no settings; None where there is
        neither."""
        size = self.size(name)
        return self.settings.get(name, None if size is None else size.value)

    def since(self, noun: str = "pose") -> str:
        """Return `` from pose 34 (95 %: 30 to 36) on``; empty where there is no onset."""
        onset = self.fact("from_step" if noun == "step" else "from_pose")
        if onset in (None, ""):
            return ""
        first, last = self.fact(ONSET_BETWEEN) or (onset, onset)
        interval = "" if first == last else f" (95 %: {first} to {last})"
        return f" from {noun} {onset}{interval} on"


class AdviceKind(StrEnum):
    """Purpose of the next measurement."""

    SEPARATE = "separate"  # separate it from its rival
    CONFIRM = "confirm"
    SHARPEN = "sharpen"  # reduce the uncertainty of its size
    ANOTHER = "another kind"  # separate it from its rival by another kind of measurement; this kind cannot
    IN_VAIN = "in vain"  # reduce the uncertainty of its size, which no number of repeats can


@dataclass(frozen=True)
class Advice:
    """Next measurement; ``short``: without settings that a table holds, empty where none does; ``purpose``: of its rows
    there."""

    kind: AdviceKind
    words: str
    short: str = ""
    purpose: str = ""


@dataclass(frozen=True)
class Wording:
    """Words for a cause: its noun; the clause that completes "The data show that ...", with sizes if known; and the
    advice.

    The advice is the measurement that confirms the cause.
    """

    noun: str
    clause: Callable[[Claim], str]
    advice: str | Callable[[Claim], str]


def size_in_words(size: ParameterSize) -> str:
    """Return ``0.210 ± 0.010 %``."""
    return size_text(size.name, size.value, size.sigma, size.unit)


def positive(size: ParameterSize) -> ParameterSize:
    """Return the size without its sign, where words give that."""
    return ParameterSize(size.name, abs(size.number or 0.0), size.sigma, size.unit)


def largest(sizes: tuple[ParameterSize, ...]) -> ParameterSize | None:
    """Return the size with the largest absolute value."""
    return max(sizes, key=lambda size: abs(size.number or 0.0), default=None)


def largest_of_kind(claim: Claim, kind: str) -> tuple[str, bool]:
    """Return the absolute value of the largest size of a kind, empty where there is none, and True if it
    is positive."""
    size = largest(claim.sizes_of(kind))
    return ("", True) if size is None else (size_in_words(positive(size)), (size.number or 0.0) > 0.0)


def determined_sizes(sizes: tuple[ParameterSize, ...]) -> list[ParameterSize]:
    """Return sizes beyond two of their sigmas, the largest first; where there are none, the largest alone."""
    known = [size for size in sizes if size.number is not None]
    sure = [size for size in known if size.sigma is None or abs(size.number or 0.0) > SURE * size.sigma]
    largest_alone = largest(tuple(known))
    return sorted(sure or ([largest_alone] if largest_alone else []), key=lambda size: -abs(size.number or 0.0))


def _leg_of(size: ParameterSize, subject: str) -> str:
    """Return the leg of a parameter, ``leg 3``, by its suffix or by the subject."""
    numbered = re.search(r"_(\d+)$", size.name)
    return f"leg {numbered[1]}" if numbered else subject_words(subject)


def by_most(claim: Claim, kind: str) -> str:
    """Return ``, by 0.21 ± 0.01 %``, or for several legs ``, most leg 3 (0.21 ± 0.01 %)``; empty without a size."""
    sizes = claim.sizes_of(kind)
    size = largest(sizes)
    if size is None:
        return ""
    return (
        f", by {size_in_words(size)}"
        if len(sizes) == 1
        else f", most {_leg_of(size, claim.subject)} ({size_in_words(size)})"
    )


def by_words(words: str) -> str:
    """Return ``, by 0.21 ± 0.01 %``; empty without words."""
    return f", by {words}" if words else ""


def largest_change_words(claim: Claim) -> str:
    """Return the largest change of measured quantities by an effect: ``, by up to 12 um``."""
    return "" if claim.largest_motion is None else f", by up to {rough(claim.largest_motion)} {claim.unit}"


def with_sizes(text: str, claim: Claim) -> str:
    """Return a clause with sizes: parameters or, where these are many, the largest change of measured quantities."""
    if len(claim.sizes) > _MOST_SHOWN and claim.largest_motion is not None:
        return text + largest_change_words(claim)
    sizes = ", ".join(f"{size.name} {size_in_words(size)}" for size in claim.sizes[:_MOST_SHOWN])
    return f"{text}: {sizes}" if sizes else text


def listed(names: Iterable[object]) -> str:
    """Return ``1``, ``1 and 4``, ``1, 4 and 10``."""
    *first, last = map(str, names)
    return f"{', '.join(first)} and {last}" if first else last
