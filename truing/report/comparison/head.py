"""The top of a comparison's page: what has changed, or that nothing has, and how the verdicts went."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.report.comparison.compared_runs import Comparison, called, told_change
from truing.report.comparison.verdicts import quality_words, requirement_words
from truing.report.numbers import count
from truing.report.page import Head
from truing.report.tables import cell, filled

if TYPE_CHECKING:
    import pandas as pd

_NAMED = 3
Verdict = tuple[str, str]


def comparison_head(found: Comparison) -> Head:
    """The sentences that a busy person acts on."""
    steps = range(len(found.between))
    said = [*_changes(found), *(effect for step in steps for effect in _effects(found, step))]
    said += [*requirement_words(found), *quality_words(found)]
    judged = sum(len(found.judged(step)) for step in steps)
    changed = int(found.numbers["changed"].sum())
    tiles = (("runs", str(len(found.runs))), ("numbers compared", f"{judged:,}"), ("changed", str(changed)))
    title = " → ".join(run.label for run in found.runs) if len(found.runs) < 4 else f"{len(found.runs)} runs"
    return Head(f"{title}: what has changed", tuple(said), tiles)


def _changes(found: Comparison) -> list[Verdict]:
    """What changed, step by step; one sentence where nothing did."""
    steps = range(len(found.between))
    loud = [("found", step_words(found, step)) for step in steps if has_changed(found, step)]
    still = [step for step in steps if not has_changed(found, step) and len(found.judged(step))]
    said = loud
    if still:
        judged = [len(found.judged(step)) for step in still]
        numbers = count(judged[0], "number") if len(set(judged)) == 1 else f"{min(judged)} to {max(judged)} numbers"
        where = f" ({', '.join(map(found.pair, still))})" if loud or len(still) < len(steps) else ""
        said = [*loud, ("pass", f"Nothing has changed beyond chance{where}: {numbers} compared from run to run.")]
    return said + [
        ("none", f"{found.pair(step)}: {why_words(found, step)}") for step in steps if found.between[step].why
    ]


def why_words(found: Comparison, step: int) -> str:
    """Why numbers of a step were not judged."""
    what = "some numbers were not judged" if len(found.judged(step)) else "no number was judged"
    return f"{what}: {'; '.join(found.between[step].why)}."


def has_changed(found: Comparison, step: int) -> bool:
    """Whether anything changed from a run to the next."""
    return found.between[step].rebuilt or bool(found.judged(step)["changed"].any())


def step_words(found: Comparison, step: int) -> str:
    """Which numbers changed beyond chance, and by how much."""
    judged = found.judged(step)
    changed = _largest_first(judged[judged["changed"]])
    if found.between[step].rebuilt:
        more = f" Beyond chance by themselves: {_named(changed)}." if len(changed) else ""
        what = "changed in more places than can be named one by one: it was rebuilt, or is another machine."
        return f"{found.pair(step)}: {what}{more}"
    return f"{found.pair(step)}: {len(changed)} of {count(len(judged), 'number')} changed: {_named(changed)}."


def _largest_first(changed: pd.DataFrame) -> pd.DataFrame:
    jump = (changed["change"] / changed["sigma_change"]).fillna(changed["z"]).abs()
    return changed.assign(jump=jump).sort_values("jump", ascending=False, kind="stable", na_position="last")


def _named(changed: pd.DataFrame) -> str:
    most = "; ".join(f"{called(r)} by {told_change(r)}{_instead(r)}" for r in changed.head(_NAMED).itertuples())
    return most + (f"; and {len(changed) - _NAMED} more" if len(changed) > _NAMED else "")


def _instead(row: object) -> str:
    others = cell(getattr(row, "instead", None))
    return f" (or {others}, which the campaigns cannot tell from it)" if others else ""


def _effects(found: Comparison, step: int) -> list[Verdict]:
    """Effects that one of two runs found and the other did not."""
    before, now = (effects_found(found, place) for place in (step, step + 1))
    said = [("new", [name for name in now if name not in before]), ("gone", [n for n in before if n not in now])]
    words = {"new": "found for the first time", "gone": "found no longer"}
    return [("warn", f"{found.pair(step)}: {words[kind]}: {', '.join(names)}.") for kind, names in said if names]


def effects_found(found: Comparison, place: int) -> list[str]:
    """The effects that the diagnosis of a run found, as the tables call them."""
    table = filled(found.runs[place].tables, "diagnosis")
    if table is None:
        return []
    own = table[table["verdict"] == "found"]
    return [f"{c} {cell(s)}".strip() for c, s in zip(own["cause"], own["subject"], strict=True)]
