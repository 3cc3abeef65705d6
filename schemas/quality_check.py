"""How a check of a campaign's quality is declared: what it asks, why, by which limits, and what to do when it trips."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol


@dataclass(frozen=True)
class CheckLimits:
    """Plain limits that a value is held against; a campaign may set others.

    of: what is held against them, with its unit in ``unit``; None: no value gives that verdict. below: values below a
    limit trip it, else those above. most: the largest limit that makes sense, as 1 of a share.
    """

    of: str
    warn: float | None = None
    fail: float | None = None
    below: bool = False
    unit: str = ""
    most: float | None = None

    @property
    def warns(self) -> str:
        """From where on the check warns, in words; empty where it never does."""
        return "" if self.warn is None else self.words(self.warn)

    @property
    def fails(self) -> str:
        """From where on the check fails, in words; empty where it never does."""
        return "" if self.fail is None else self.words(self.fail)

    def words(self, limit: float) -> str:
        """A limit, and on which side of it a value trips it."""
        return f"{'below' if self.below else 'above'} {limit:g} {self.unit}".strip()


@dataclass(frozen=True)
class VerdictRule:
    """Verdicts that rest on chance, whose budget is [qa] false_alarm, or on what is wrong whatever its size."""

    warns: str = ""
    fails: str = ""


@dataclass(frozen=True)
class QualityCheck:
    """A check: what it asks, why that matters, how it is judged, and what to do when it trips; one sentence or two.

    withholds: what is not evaluated while it fails, because the data do not belong together as the campaign describes
    them: "models" are deformation, diagnosis and calibration, "poses" are these and the poses. Empty: an ordinary
    failure, beside which later results can still be true.
    """

    question: str
    why: str
    criterion: CheckLimits | VerdictRule
    to_do: str
    withholds: Literal["", "models", "poses"] = ""

    @property
    def stages_withheld(self) -> str:
        """What is not evaluated while it fails, in words; empty of an ordinary check."""
        models = "deformation, diagnosis and calibration"
        return {"": "", "models": models, "poses": f"poses, {models}"}[self.withholds]


Checks = Mapping[str, QualityCheck]


class DeclaredCheck(Protocol):
    """A check that an installed package adds: its name, its kind of campaign, and its declaration."""

    name: ClassVar[str]
    kind: ClassVar[str]
    declared: ClassVar[QualityCheck]


# What campaigns of either kind are asked alike.
TEMPERATURE_UNIT = QualityCheck(
    "Are recorded temperatures and [mechanism] reference_temperature_c in degrees Celsius?",
    "Kelvin or degrees Fahrenheit pass as a warming by tens or hundreds of kelvins, and everything grows by it.",
    VerdictRule(
        warns="a reference like one in another unit, with nothing to contradict it",
        fails="a column and the reference that contradict each other by a unit, or parts of a column that do",
    ),
    'Say the unit in [files] (`units = { temperature_c = "K" }`), convert the rows that are named, or correct '
    "the reference. A part in another unit is told by steps of 25 K and more that the conversion undoes.",
    withholds="models",
)


def time_unit(row: str) -> QualityCheck:
    """Whether times can be seconds; ``row``: what a row of the table is, a pose or a step."""
    return QualityCheck(
        f"Can the column `time_s` be seconds, by its pace from {row} to {row} and by how far it counts?",
        "Days of a spreadsheet, hours or milliseconds turn every drift, creep and pause into one of another size.",
        VerdictRule(
            warns="a median pace below 0.2 s or above 20000 s that another unit makes likely; counts since 1970"
        ),
        'Say the unit in [files] (`units = { time_s = "d" }`, or `columns = { time_s = { scale = 1e-9 } }`). '
        "Passes without a word: minutes at a pace that seconds may have, and even paces of a clock. Not evaluated: "
        "fewer than 12 times, or times that merely count.",
    )
