"""What a wording speaks of: a cause with its settings, and its sizes where these are to be told."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Self

from truing.report.diagnosis.effect_units import stem


@dataclass(frozen=True)
class Size:
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
    sizes: tuple[Size, ...] = ()
    follows: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    words: str = ""
    largest_motion: float | None = None
    unit: str = ""
    reach: Reach | None = None

    def size(self, name: str) -> Size | None:
        """The parameter of that name."""
        return next((size for size in self.sizes if size.name == name), None)

    def sizes_of(self, kind: str) -> tuple[Size, ...]:
        """The parameters of a kind, one per leg where each leg has its own."""
        return tuple(size for size in self.sizes if stem(size.name) == kind and size.number is not None)

    def fact(self, name: str) -> Any:
        """A setting, or the parameter of that name where the table holds no settings; None where neither is there."""
        size = self.size(name)
        return self.settings.get(name, None if size is None else size.value)

    def without_sizes(self) -> Self:
        """The claim of a cause whose sizes mean nothing, or stand behind its clause."""
        return replace(self, sizes=(), largest_motion=None, reach=None)


class AdviceKind(StrEnum):
    """What the next measurement is for."""

    SEPARATE = "separate"  # tell it from its rival
    CONFIRM = "confirm"
    SHARPEN = "sharpen"  # know its size better
    ANOTHER = "another kind"  # tell it from its rival, which nothing within reach does
    IN_VAIN = "in vain"  # know its size better, which no number of repeats brings


@dataclass(frozen=True)
class Advice:
    """What to measure next; ``short``: without the settings that a table holds, empty where none does."""

    kind: AdviceKind
    words: str
    short: str = ""


@dataclass(frozen=True)
class Wording:
    """How a cause is spoken of: its noun; the clause on what nature does, with sizes where the claim has some, to
    complete "The data show that ..."; and the advice what to measure to confirm it."""

    noun: str
    clause: Callable[[Claim], str]
    advice: str | Callable[[Claim], str]
