"""What a wording speaks of, a cause with its settings and sizes; and what clauses on it are put together from."""

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

# A component that is smaller than this many of its standard deviations is not told.
_SURE = 2.0
# How many sizes a clause tells one by one.
_TOLD = 3


@dataclass(frozen=True)
class ParameterSize:
    """A parameter of a cause: value, one sigma (None for text and counts) and unit, as the table tells them."""

    name: str
    value: Any
    sigma: float | None
    unit: str

    @property
    def number(self) -> float | None:
        """The value where it is a number."""
        plain = isinstance(self.value, (int, float)) and not isinstance(self.value, bool)
        return float(self.value) if plain and math.isfinite(self.value) else None


@dataclass(frozen=True)
class Reach:
    """The largest shift in um, and the legs (from 1) that it concerns: one, or two that it moves against each other.

    ``sigma`` in um, of parameters taken as uncorrelated, as the table of the diagnosis tells no more of them.
    """

    largest: float
    legs: tuple[int, ...]
    sigma: float | None = None


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One candidate cause as the tables tell it.

    ``settings``: the fields of the cause, and the ``step`` of the chain at which it acts. ``words``: the clause of a
    cause that is not the project's own. ``largest_motion``, in ``unit``: how far it moves anything that was measured;
    ``reach``: how far it moves the attachments.
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

    def size(self, name: str) -> ParameterSize | None:
        """The parameter of that name."""
        return next((size for size in self.sizes if size.name == name), None)

    def sizes_of(self, kind: str) -> tuple[ParameterSize, ...]:
        """The parameters of a kind, one per leg where each leg has its own."""
        return tuple(size for size in self.sizes if stem(size.name) == kind and size.number is not None)

    def fact(self, name: str) -> Any:
        """A setting, or the parameter of that name where the table holds no settings; None where neither is there."""
        size = self.size(name)
        return self.settings.get(name, None if size is None else size.value)


class AdviceKind(StrEnum):
    """What the next measurement is for."""

    SEPARATE = "separate"  # tell it from its rival
    CONFIRM = "confirm"
    SHARPEN = "sharpen"  # know its size better
    ANOTHER = "another kind"  # tell it from its rival, which nothing within reach does
    IN_VAIN = "in vain"  # know its size better, which no number of repeats brings


@dataclass(frozen=True)
class Advice:
    """What to measure next; ``short``: without the settings that a table holds, empty where none does; ``purpose``:
    that of its rows there."""

    kind: AdviceKind
    words: str
    short: str = ""
    purpose: str = ""


@dataclass(frozen=True)
class Wording:
    """How a cause is spoken of: its noun; the clause on what nature does, with sizes where the claim has some, to
    complete "The data show that ..."; and the advice what to measure to confirm it."""

    noun: str
    clause: Callable[[Claim], str]
    advice: str | Callable[[Claim], str]


def size_in_words(size: ParameterSize) -> str:
    """``0.210 ± 0.010 %``."""
    return size_text(size.name, size.value, size.sigma, size.unit)


def positive(size: ParameterSize) -> ParameterSize:
    """The size without its sign, where words tell that."""
    return ParameterSize(size.name, abs(size.number or 0.0), size.sigma, size.unit)


def largest(sizes: tuple[ParameterSize, ...]) -> ParameterSize | None:
    """The size that is farthest from nothing."""
    return max(sizes, key=lambda size: abs(size.number or 0.0), default=None)


def only(claim: Claim, kind: str) -> tuple[str, bool]:
    """The largest size of a kind without its sign, empty where there is none, and whether it is positive."""
    size = largest(claim.sizes_of(kind))
    return ("", True) if size is None else (size_in_words(positive(size)), (size.number or 0.0) > 0.0)


def sure_of(sizes: tuple[ParameterSize, ...]) -> list[ParameterSize]:
    """Sizes that are beyond two of their sigmas, the largest first; where none is, the largest alone."""
    known = [size for size in sizes if size.number is not None]
    sure = [size for size in known if size.sigma is None or abs(size.number or 0.0) > _SURE * size.sigma]
    alone = largest(tuple(known))
    return sorted(sure or ([alone] if alone else []), key=lambda size: -abs(size.number or 0.0))


def _leg_of(size: ParameterSize, subject: str) -> str:
    """``leg 3``: whose parameter it is, by its suffix or by the subject."""
    numbered = re.search(r"_(\d+)$", size.name)
    return f"leg {numbered[1]}" if numbered else subject_words(subject)


def by_most(claim: Claim, kind: str) -> str:
    """``, by 0.21 ± 0.01 %``, or of several legs ``, most leg 3 (0.21 ± 0.01 %)``; nothing without a size."""
    sizes = claim.sizes_of(kind)
    size = largest(sizes)
    if size is None:
        return ""
    return (
        f", by {size_in_words(size)}"
        if len(sizes) == 1
        else f", most {_leg_of(size, claim.subject)} ({size_in_words(size)})"
    )


def by(words: str) -> str:
    """``, by 0.21 ± 0.01 %``; nothing of nothing."""
    return f", by {words}" if words else ""


def moves(claim: Claim) -> str:
    """``, by up to 12 um``: how far the effect moves what was measured."""
    return "" if claim.largest_motion is None else f", by up to {rough(claim.largest_motion)} {claim.unit}"


def with_sizes(text: str, claim: Claim) -> str:
    """A clause, and how large it is: its parameters, or where these are many, how far it moves what was measured."""
    if len(claim.sizes) > _TOLD and claim.largest_motion is not None:
        return text + moves(claim)
    sizes = ", ".join(f"{size.name} {size_in_words(size)}" for size in claim.sizes[:_TOLD])
    return f"{text}: {sizes}" if sizes else text


def listed(names: Iterable[object]) -> str:
    """``1``, ``1 and 4``, ``1, 4 and 10``."""
    *first, last = map(str, names)
    return f"{', '.join(first)} and {last}" if first else last
