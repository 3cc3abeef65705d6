"""Words and page on a campaign that is watched while it is measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from html import escape

from truing.belonging.relation import RelationState
from truing.report.calibration.requirements import assessed_noun, chosen_requirements
from truing.report.first_screen import counts
from truing.report.numbers import count_text
from truing.report.section_verdict import SectionVerdict, verdict_rows
from truing.report.tables import Tables, table_or_none
from truing.schemas.verdict import CAMPAIGN, GATES, OF_MODEL, ReasonCode

SECONDS_BETWEEN_LOOKS = 2.0  # of an open page


class Enough(StrEnum):
    """State of the requirements, as the measurements decide them."""

    ENOUGH = "enough"
    TO_CONFIRM = "to confirm"  # every requirement is decided, but not yet at a later look with more poses
    NOT_ENOUGH = "not enough"
    NOT_STATED = "not stated"  # [requirement] asks for nothing, or for nothing that this campaign can tell
    NOT_JUDGED = "not judged"  # the data are faulty, or no model fits them


_DECIDED = (ReasonCode.MET, ReasonCode.NOT_MET)
_WORDS = {
    Enough.ENOUGH: "Enough: every requirement is decided.",
    Enough.TO_CONFIRM: "Decided at this look; more measurements have to confirm it.",
    Enough.NOT_ENOUGH: "Not enough yet: a requirement is undecided.",
    Enough.NOT_STATED: "No requirement decides when to stop.",
    Enough.NOT_JUDGED: "Requirements cannot be judged yet.",
}


@dataclass(frozen=True)
class Watched:
    """State after one round: number and time of the round, measured amount in words, verdicts by section, faults, and
    the most urgent next measurement in words. Also: whether earlier looks confirm the decision, and from how many
    compared poses (or runs of a force sensor: ``compared``) on a look can."""

    campaign: str
    number: int
    at: datetime
    amount: str
    verdicts: tuple[SectionVerdict, ...]
    faults: tuple[str, ...]
    following: str
    is_confirmed: bool = False
    poses_to_confirm: int | None = None
    compared: str = "pose"

    @property
    def enough(self) -> Enough:
        """State of the requirements, as the measurements decide them."""
        by_section = {row.section: row for row in self.verdicts}
        gates = [by_section[name] for name in GATES if name in by_section]
        if self.faults or not by_section or any(row.state is RelationState.FAILS for row in gates):
            return Enough.NOT_JUDGED
        requirements = by_section.get("requirements")
        if requirements is None or requirements.reason_code is ReasonCode.NOT_EVALUATED:
            return Enough.NOT_STATED
        if requirements.reason_code in _DECIDED:
            if not _model_holds(by_section):  # "not met" by a model that does not fit; more data may give another one
                return Enough.NOT_JUDGED
            return Enough.ENOUGH if self.is_confirmed else Enough.TO_CONFIRM
        return Enough.NOT_ENOUGH if requirements.reason_code is ReasonCode.UNDECIDED else Enough.NOT_JUDGED

    @property
    def line(self) -> str:
        """One line on the round."""
        parts = [f"{self.at:%H:%M:%S} round {self.number}:", *([f"{self.amount};"] if self.amount else [])]
        if self.faults:
            more = f" (and {count_text(len(self.faults) - 1, 'further fault')})" if len(self.faults) > 1 else ""
            return " ".join([*parts, f"{self.faults[0]}{more}"])
        requirement = [row.explanation for row in self.verdicts if row.section == "requirements"]
        parts += [_WORDS[self.enough], *requirement, *self.confirmation()]
        return " ".join([*parts, *([f"Next: {self.following}"] if self.following else [])])

    def confirmation(self) -> list[str]:
        """Return one sentence on the confirmation of a decision; empty where none is to be confirmed."""
        if self.enough is not Enough.TO_CONFIRM or self.poses_to_confirm is None:
            return []
        return [f"It is confirmed when {self.poses_to_confirm} compared {self.compared}s or more say the same."]

    def facts(self) -> dict[str, object]:
        """Facts for JSON."""
        rows = [
            {"section": row.section, "state": str(row.state), "reason_code": str(row.reason_code)}
            | {"explanation": row.explanation}
            for row in self.verdicts
        ]
        return {
            "campaign": self.campaign,
            "round": self.number,
            "time": self.at.isoformat(timespec="seconds"),
            "enough": str(self.enough),
            "poses_to_confirm": self.poses_to_confirm if self.enough is Enough.TO_CONFIRM else None,
            "measured": self.amount or None,
            "next_measurement": self.following or None,
            "faults": list(self.faults),
            "verdicts": rows,
        }


def watched(campaign: str, number: int, at: datetime, tables: Tables, faults: tuple[str, ...]) -> Watched:
    """Return the state after a round, from the tables of its run; only faults count where there are any."""
    if faults:
        return Watched(campaign, number, at, "", (), faults, "")
    steps = table_or_none(tables, "next_measurements")
    following = "" if steps is None or not len(steps) else str(steps.iloc[0]["next_measurement"])
    requirements = chosen_requirements(tables)
    compared = "pose" if requirements is None else assessed_noun(requirements)
    verdicts = tuple(verdict_rows(tables).values())
    return Watched(campaign, number, at, counts(tables), verdicts, (), following, compared=compared)


@dataclass(frozen=True)
class RequirementLook:
    """Result of one round for the requirements: number of compared poses or runs, decision (empty: none), p-value
    against the limits."""

    poses: int
    decision: str
    p_value: float


def requirement_look(tables: Tables) -> RequirementLook | None:
    """Return the decision of a round on the requirements; None where the model that judges them does not hold.

    All requirements have to be met, so the least certain one counts; for *not met* one of all, with its share.
    """
    verdicts, requirements = verdict_rows(tables), chosen_requirements(tables)
    verdict = verdicts.get("requirements")
    if requirements is None or verdict is None or not _model_holds(verdicts):
        return None
    failed = requirements["p_value"][requirements["verdict"] == "fails"]
    p = float(failed.min()) * len(requirements) if len(failed) else float(requirements["p_value"].max())
    decision = str(verdict.reason_code) if verdict.reason_code in _DECIDED else ""
    return RequirementLook(int(requirements["poses_judged"].min()), decision, min(p, 1.0))


def _model_holds(verdicts: Mapping[str, SectionVerdict]) -> bool:
    """Return True unless the model that predicts the errors fails one of its tests."""
    failed = (verdicts[name].state is RelationState.FAILS for name in OF_MODEL if name in verdicts)
    return not any(failed)


def watch_page(state: Watched | None, has_report: bool) -> str:
    """Return the page on a state; it loads itself again after each round."""
    number, body = 0, "<p>Waiting for the first files.</p>"
    if state is not None:
        number, body = state.number, _body(state, has_report)
    return _PAGE.format(
        title=escape(state.campaign if state else "campaign"),
        number=number,
        body=body,
        looks_ms=1e3 * SECONDS_BETWEEN_LOOKS,
    )


def _body(state: Watched, has_report: bool) -> str:
    parts = [f"<p class=lead>{escape(_WORDS[state.enough])}</p>"]
    amount = f"{state.amount}, " if state.amount else ""
    parts += [f"<p>{escape(text)}</p>" for text in state.confirmation()]
    parts.append(f"<p>{escape(amount)}round {state.number}, {state.at:%Y-%m-%d %H:%M:%S}</p>")
    if state.faults:
        parts.append("<h2>Correct first</h2><ul>" + "".join(f"<li>{escape(text)}" for text in state.faults) + "</ul>")
    if state.following:
        parts.append(f"<h2>Measure next</h2><p>{escape(state.following)}</p>")
    rows = "".join(
        f"<tr class={row.mark}><td>{escape(row.section)}<td>{escape(row.word)}<td>{escape(row.explanation)}"
        for row in state.verdicts
        if row.section != CAMPAIGN
    )
    if rows:
        parts.append(f"<h2>Known by now</h2><table><tr><th>section<th>state<th>explanation{rows}</table>")
    if has_report:
        parts.append('<p><a href="report.html">Full page of this round</a></p>')
    return "\n".join(parts)


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}: watched</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222 }}
.lead {{ font-size: 1.4rem; font-weight: 600 }}
table {{ border-collapse: collapse; width: 100% }}
td, th {{ text-align: left; vertical-align: top; padding: .4rem .8rem .4rem .6rem; border-top: 1px solid #ddd }}
tr.pass td:first-child {{ border-left: 4px solid #2a7f4f }} tr.warn td:first-child {{ border-left: 4px solid #b7791f }}
tr.fail td:first-child {{ border-left: 4px solid #b02a2a }} tr.none td:first-child {{ border-left: 4px solid #bbb }}
@media (max-width: 40rem) {{ table, tr, td {{ display: block; border: 0 }} th {{ display: none }} }}
tr.found td:first-child, tr.measured td:first-child {{ border-left: 4px solid #2b5fa8 }}
</style></head><body data-round="{number}">
<h1>{title}</h1>
<p id="ended" hidden>The command has ended: this is its last round.</p>
{body}
<script>
setInterval(async () => {{
  try {{
    const answer = await fetch("round");
    if (answer.ok && await answer.text() !== document.body.dataset.round) location.reload();
  }} catch (gone) {{ document.getElementById("ended").hidden = false; }}
}}, {looks_ms:.0f});
</script></body></html>
"""
