"""Candidate causes as rows for the page: verdict, evidence, and sizes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from truing.report.diagnosis.findings import subject_words
from truing.report.tables import Tables, cell, table_or_none
from truing.report.wordings.catalogue import cause_words, noun_of_subject
from truing.report.wordings.claim import Claim, ParameterSize
from truing.report.wordings.nonparametric_wordings import columns_words
from truing.schemas.covariates import names_in

FOUND, SUSPECTED, RIVAL = "found", "suspected", "indistinguishable"
REJECTED, NOT_TESTABLE = "rejected", "not testable"
# Values of the column scale_holds: does a cause keep its rank if assumed effect sizes are tripled?
HOLDS, CHANGES = "holds", "changes"
# Reason code of inputs that predict the residuals where no model of causes holds.
REMAINDER = "remainder"
# Setting of such inputs: the model with all accepted causes no longer shows them.
WITHOUT_FINDINGS = "without_findings"
# Setting of such inputs: the accepted causes may explain a part of what they predict, and the rest remains.
PARTLY_BY_FINDINGS = "partly_by_findings"
# Causes that move nothing on average: what they explain counts as noise.
SCATTERING = frozenset({"approach-scatter", "noise-burst"})
# Odds below which two causes count as explaining the data equally well.
EQUAL_ODDS = 20.0


NOISE_ALONE = "noise not as declared"  # name of a finding that has no mean effect


@dataclass(frozen=True, kw_only=True)
class AssessedCause(Claim):
    """One candidate cause with its verdict; rms in ``unit``, None if not evaluated."""

    rank: int
    verdict: str
    reason_code: str
    relation: str  # quantities that its search relates; empty where the run is older than the column
    rms: tuple[float | None, float | None]
    held_out: tuple[float | None, float | None]
    without_any: tuple[float | None, float | None]  # fitted and held-out data, without all accepted causes
    floor: float | None
    explanation: str
    then: str
    in_short: str
    next_purpose: str  # purpose of its rows in next_poses or next_loads; empty where it has none
    advice_kind: str
    p_value: float | None
    probability: float | None
    evidence: float | None  # natural logarithm of the odds over the model without it
    signal_to_noise: float | None
    holds: str
    left_out_by: str = ""  # kind of the blocks left out; empty where the run is older than the column
    left_out_blocks: int = 0
    left_out_gain: float | None = None
    share_predicted: float | None = None
    held_out_growth: float | None = None  # of all held-out errors with it, in units of their noise
    in_model: bool = True  # whether the extended model holds it

    @property
    def is_noise(self) -> bool:
        """True if it has no mean effect in the model: larger scatter than declared, or inputs that
        predict residuals."""
        return self.is_remainder or self.reason_code == "noise" or any(s.name == "noise_ratio" for s in self.sizes)

    @property
    def is_remainder(self) -> bool:
        """True if it names inputs that predict the residuals where no model of causes holds."""
        return self.reason_code == REMAINDER

    @property
    def is_conditional(self) -> bool:
        """True if it names inputs that predict residuals only while other findings are left out of the model."""
        return bool(self.settings.get(WITHOUT_FINDINGS))

    @property
    def is_partly_explained(self) -> bool:
        """True if other findings may explain a part of what it predicts, and the rest remains."""
        return bool(self.settings.get(PARTLY_BY_FINDINGS))

    @property
    def is_higher_order(self) -> bool:
        """True if it holds terms of higher order of a nonparametric effect, which is the same effect."""
        return self.cause == "unexplained" and int(self.settings.get("first") or 1) > 1

    def has_terms(self, other: AssessedCause) -> bool:
        """Return True if another cause holds terms of higher order of this effect: same subject, inputs and form."""
        law_of_this, law_of_other = (
            (row.cause, row.subject, row.follows, row.settings.get("form")) for row in (self, other)
        )
        return law_of_this == law_of_other and other.is_higher_order and not self.is_higher_order

    @property
    def raises_floor(self) -> bool:
        """True if its effect counts as noise, so that the noise floor exceeds what the declared noise gives.

        That all noise is larger than declared raises no floor, which is that of the declared noise.
        """
        return self.cause in SCATTERING or (self.is_noise and not self.is_remainder and bool(self.follows))

    @property
    def name(self) -> str:
        """Cause with its subject in a table: ``actuator gain, leg 3``."""
        return f"{self._kind}, {subject_words(self.subject)}" if self.subject else self._kind

    @property
    def in_sentence(self) -> str:
        """Cause with its subject in a sentence, no word twice: ``compliance of joint elbow``."""
        return noun_of_subject(self._kind, self.subject)

    @property
    def _kind(self) -> str:
        kind = cause_words(self.cause)
        if self.is_noise and not self.is_remainder and self.cause == "unexplained":
            return NOISE_ALONE
        is_untimed = "order" in (self.settings.get("columns") or ())  # tables have times, which number the rows
        inputs = tuple("order" if is_untimed and name == "time_s" else name for name in self.follows)
        return f"{kind} of {columns_words(inputs)}" if self.cause == "unexplained" and inputs else kind


def assessed_causes(tables: Tables) -> list[AssessedCause]:
    """Return all candidates by rank; none where the diagnosis was not evaluated."""
    table = table_or_none(tables, "diagnosis")
    if table is None:
        return []
    return [_assessed_cause(row) for row in table.sort_values("rank").to_dict("records")]


def accepted_of(rows: list[AssessedCause]) -> list[AssessedCause]:
    """Return the causes that were found or are suspected, in the order of acceptance."""
    return [row for row in rows if row.verdict in (FOUND, SUSPECTED)]


def testable_of(rows: list[AssessedCause]) -> list[AssessedCause]:
    """Return the candidates that this campaign could have shown."""
    return [row for row in rows if row.verdict != NOT_TESTABLE and not row.is_noise]


def modelled_of(rows: list[AssessedCause]) -> list[AssessedCause]:
    """Return the causes with a mean effect that the extended model holds, in the order of acceptance."""
    return [row for row in accepted_of(rows) if row.in_model and not row.is_noise]


def _assessed_cause(row: Mapping[Any, Any]) -> AssessedCause:
    return AssessedCause(
        rank=int(row["rank"]),
        cause=str(row["cause"]),
        verdict=str(row["verdict"]),
        subject=cell(row["subject"]).strip(),
        sizes=_sizes(cell(row["parameters"])),
        follows=names_in(cell(row["follows"])),
        settings=json.loads(cell(row.get("settings")) or "{}"),
        words=cell(row.get("clause")),
        largest_motion=_number(row.get("largest_motion")),
        reason_code=cell(row.get("reason_code")),
        relation=cell(row.get("relation")),
        rms=(_number(row["rms_before"]), _number(row["rms_after"])),
        held_out=(_number(row["heldout_rms_before"]), _number(row["heldout_rms_after"])),
        without_any=(_number(row.get("rms_without_any")), _number(row.get("heldout_rms_without_any"))),
        floor=_number(row["noise_floor"]),
        unit=cell(row["unit"]),
        explanation=cell(row["explanation"]),
        then=cell(row["next_measurement"]),
        in_short=cell(row.get("next_in_short")),
        next_purpose=cell(row.get("next_purpose")),
        advice_kind=cell(row.get("advice_kind")),
        p_value=_number(row["p_value"]),
        probability=_number(row["probability"]),
        evidence=_number(row.get("log_evidence")),
        signal_to_noise=_number(row.get("signal_to_noise")),
        holds=cell(row.get("scale_holds")),
        left_out_by=cell(row.get("left_out_by")),
        left_out_blocks=int(_number(row.get("left_out_blocks")) or 0),
        left_out_gain=_number(row.get("left_out_gain")),
        share_predicted=_number(row.get("share_predicted")),
        held_out_growth=_number(row.get("heldout_growth")),
        in_model=cell(row.get("in_model")) != "False",
    )


def _sizes(parameters: str) -> tuple[ParameterSize, ...]:
    reported = json.loads(parameters) if parameters else {}
    return tuple(
        ParameterSize(name, facts.get("value"), _number(facts.get("sigma")), cell(facts.get("unit")))
        for name, facts in reported.items()
    )


def _number(value: Any) -> float | None:
    """Return a finite number, or None."""
    known = isinstance(value, (int, float)) and math.isfinite(value)
    return float(value) if known else None


def total_gain(causes: list[AssessedCause], held_out: bool) -> tuple[float, float] | None:
    """Return the rms before and after all accepted causes; None where it was not evaluated, or in mixed units."""
    effects = modelled_of(causes)
    if not effects or len({row.unit for row in effects}) > 1:
        return None
    pairs = [row.held_out if held_out else row.rms for row in effects]
    # A cause that was compared next to all others has, before it, the errors with the others.
    without_any = effects[0].without_any[held_out]
    before, after = pairs[0][0] if without_any is None else without_any, pairs[-1][1]
    return None if before is None or after is None else (before, after)


def share_removed(before: float, after: float, floor: float) -> float | None:
    """Return the share of the variance beyond noise that is removed: 1 - (after^2 - floor^2) / (before^2 - floor^2), at
    most 1."""
    excess = before**2 - floor**2
    return min(1.0, 1.0 - (after**2 - floor**2) / excess) if excess > 0.0 else None
