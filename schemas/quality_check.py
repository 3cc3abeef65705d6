"""Declaration of a quality check: question, reason, limits, and remedy for a warning or failure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol


@dataclass(frozen=True)
class CheckLimits:
    """Limits of a value; a campaign may set others.

    of: the quantity, in ``unit``. warn, fail: None if no value gives that verdict. below: values below the limit give
    it, else those above. most: largest allowed limit, as 1 of a share.
    """

    of: str
    warn: float | None = None
    fail: float | None = None
    below: bool = False
    unit: str = ""
    most: float | None = None

    @property
    def warns(self) -> str:
        """Condition of a warning in words; empty if there is none."""
        return "" if self.warn is None else self.words(self.warn)

    @property
    def fails(self) -> str:
        """Condition of a failure in words; empty if there is none."""
        return "" if self.fail is None else self.words(self.fail)

    def words(self, limit: float) -> str:
        """A limit with its side and unit."""
        return f"{'below' if self.below else 'above'} {limit:g} {self.unit}".strip()


@dataclass(frozen=True)
class VerdictRule:
    """Conditions of significance tests (their budget is [qa] false_alarm), or of faults that are wrong at any size."""

    warns: str = ""
    fails: str = ""


@dataclass(frozen=True)
class QualityCheck:
    """A quality check: question, reason, criterion and remedy, one or two sentences each.

    not_evaluated: what keeps it from being evaluated, or what would let it be; no sentence, empty if nothing does.
    withholds: results that are not evaluated while it fails: "models" are deformation, diagnosis and calibration;
    "poses" are these and the poses. Empty: later stages still run.
    """

    question: str
    why: str
    criterion: CheckLimits | VerdictRule
    to_do: str
    withholds: Literal["", "models", "poses"] = ""
    not_evaluated: str = ""

    @property
    def instructions(self) -> str:
        """The remedy, and the reasons for which the check is not evaluated."""
        return f"{self.to_do} Not evaluated: {self.not_evaluated}." if self.not_evaluated else self.to_do

    @property
    def stages_withheld(self) -> str:
        """Results that are not evaluated while it fails, in words; empty if all are."""
        models = "deformation, diagnosis and calibration"
        return {"": "", "models": models, "poses": f"poses, {models}"}[self.withholds]


Checks = Mapping[str, QualityCheck]


class DeclaredCheck(Protocol):
    """A check of an installed package: name, kind of campaign and declaration."""

    name: ClassVar[str]
    kind: ClassVar[str]
    declared: ClassVar[QualityCheck]


# Checks of both kinds of campaigns.
TEMPERATURE_UNIT = QualityCheck(
    "Are recorded temperatures and [mechanism] reference_temperature_c in degrees Celsius?",
    "Kelvin or degrees Fahrenheit look like a warming of tens or hundreds of kelvins.",
    VerdictRule(
        warns="a reference that looks like another unit, without a column to compare",
        fails="a unit that explains a difference between column and reference, or between parts of a column",
    ),
    'Declare the unit in [files] (`units = { temperature_c = "K" }`), convert the named rows, or correct the '
    "reference. Steps of 25 K and more that a conversion removes show a part in another unit.",
    withholds="models",
)


def time_unit(row: str) -> QualityCheck:
    """Check that times can be seconds; ``row``: pose or step."""
    return QualityCheck(
        f"Can the column `time_s` be seconds, by its interval from {row} to {row} and its range?",
        "Days, hours or milliseconds change the size of every drift, creep and pause.",
        VerdictRule(
            warns="a median interval below 0.2 s or above 20000 s that another unit makes plausible; counts since 1970"
        ),
        'Declare the unit in [files] (`units = { time_s = "d" }`, or `columns = { time_s = { scale = 1e-9 } }`). The '
        "check cannot detect minutes at plausible intervals, nor constant intervals.",
        not_evaluated="fewer than 12 times, or times that only count",
    )
