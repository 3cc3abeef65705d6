"""Belonging tests as tables, and results that a failed test withholds."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import pyarrow as pa

from truing.belonging.relation import RecordSlip, RelationTest
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.axis_checks import OF_POSITIONS
from truing.schemas.quality_checks import WITHHOLDING


def belonging_table(tested: Sequence[RelationTest], accepted: Sequence[str | None]) -> pa.Table:
    """Return the artifact ``belonging``: one row per tested relation."""
    rows = [_row(test, who) for test, who in zip(tested, accepted, strict=True)]
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["belonging"].arrow_schema())


def _row(tested: RelationTest, accepted: str | None) -> dict[str, object]:
    return {
        "relation": tested.relation,
        "subject": tested.subject,
        "state": tested.state.value,
        "reason_code": tested.reason,
        "misfit": tested.misfit,
        "misfit_explained": tested.misfit_explained,
        "limit": tested.limit,
        "unit": tested.unit,
        "slips": _json(tested.slips),
        "rivals": _json(tested.rivals),
        "hidden_slips": _json(tested.hidden),
        "tried": tested.tried,
        "accepted": accepted,
    }


def _json(slips: Sequence[RecordSlip]) -> str:
    return json.dumps([asdict(slip) for slip in slips])


def failed_relations(tables: Mapping[str, pa.Table], *, of_poses: bool = False) -> list[str]:
    """Return the failed checks that withhold results and were not accepted, each once, in order.

    ``tables`` contains ``qa``; ``QualityCheck.withholds`` declares them. ``of_poses``: only those that withhold poses
    too.
    """
    rows = tables["qa"].to_pylist() if "qa" in tables else []
    failed = (row["check"] for row in rows if row["verdict"] == "fail" and not row.get("accepted"))
    scopes = ("poses",) if of_poses else ("poses", "models")
    return [name for name in dict.fromkeys(failed) if name in WITHHOLDING and WITHHOLDING[name].withholds in scopes]


def reason_withheld(tables: Mapping[str, pa.Table], *, of_poses: bool = False) -> str:
    """Return the reason why results of these tables are withheld (``failed_relations``); else empty."""
    failed = failed_relations(tables, of_poses=of_poses)
    return f"the data contradict the campaign's description: see {', '.join(failed)} under Quality" if failed else ""


def subject_of(run: int | str) -> str:
    """Return the subject of a positioning run in qa.parquet."""
    return f"run {run}"


def withheld_runs(tables: Mapping[str, pa.Table]) -> Mapping[str, str]:
    """Return the reason by positioning run that is not evaluated: its first failed check that was not accepted."""
    rows = tables["qa"].to_pylist() if "qa" in tables else []
    failed = [r for r in rows if r["check"] in OF_POSITIONS and r["verdict"] == "fail" and not r.get("accepted")]
    return {row["subject"]: f"{row['message'].rstrip('.')} (check {row['check']})" for row in reversed(failed)}
