"""Summary of a run as JSON for a lab's database: sentences, checks, causes, calibration, requirements."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pandas as pd

from truing.arrays import TableRow
from truing.report.calibration.calibrations import main_calibration, rows_of
from truing.runs.recorded_run import Run
from truing.schemas.settings_text import Document

_FORMAT = 1  # increases with every incompatible change
_AS_THEY_ARE = ("diagnosis_choices", "calibrations_compared", "second_campaign_errors")


def summary(run: Run) -> Iterator[tuple[str, bytes]]:
    """Yield the summary; results that were not evaluated are absent, and missing numbers are null."""
    reported = {
        "format": _FORMAT,
        "campaign": run.campaign,
        "software_versions": sorted({run.origin(name)["software_version"] for name in run}),
        "verdict": _rows(run.verdict),
        "verdicts": [{"mark": mark, "sentence": sentence} for mark, sentence in run.verdicts],
        **_quality(run),
        **_causes(run),
        **_calibration(run),
        **_sensor(run),
        **{name: _rows(run[name]) for name in _AS_THEY_ARE if name in run},
        **_uncertainty(run),
        "artifacts": {name: _artifact(run, name) for name in run},
    }
    yield "summary.json", (json.dumps(reported, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _artifact(run: Run, name: str) -> dict[str, object]:
    origin = run.origin(name)
    rows = len(run.table(name))
    return {"file": run.files[name].name, "rows": rows, "stage": origin["stage"], "digest": origin["digest"]}


def _quality(run: Run) -> dict[str, object]:
    if "qa" not in run:
        return {}
    checks = run["qa"]
    reported = checks[checks["verdict"].isin(["warn", "fail"])]
    accepted = checks["accepted"].notna() if "accepted" in checks else checks["verdict"].isna()
    failed = checks[checks["verdict"].eq("fail") & ~accepted]
    counts = checks["verdict"].value_counts().sort_index().to_dict()
    belonging = {"belonging": _rows(run["belonging"])} if "belonging" in run else {}
    return {
        "qa": {"verdicts": counts, "told": _rows(reported), "failed": _rows(failed[["check", "subject"]])},
        **belonging,
    }


def _causes(run: Run) -> Document:
    if "diagnosis" not in run:
        return {}
    rows = _rows(run["diagnosis"])
    for row in rows:
        row["parameters"] = json.loads(row["parameters"] or "{}")
    return {"causes": rows}


def _calibration(run: Run) -> dict[str, object]:
    tables = {name: run[name] for name in ("model_choice", "calibration", "requirements") if name in run}
    key = main_calibration(tables)
    if key is None:
        return {}
    chosen = {name: _rows(rows_of(table, key)) for name, table in tables.items()}
    return {"calibration": {"model": key[0], "deformation": key[1], **chosen}}


def _sensor(run: Run) -> Document:
    reported = {}
    if "sensor_matrix" in run:
        matrix = run["sensor_matrix"]
        reported["sensor_matrix"] = _rows(matrix[matrix["chosen"]])
    if "error_classes" in run:
        reported["error_classes"] = _rows(run["error_classes"])
    return reported


def _uncertainty(run: Run) -> dict[str, object]:
    """Return every result with its expanded uncertainty, or the reason why none is stated, and effects in no budget."""
    if "uncertainty" not in run:
        return {}
    reported: dict[str, object] = {"uncertainty": _rows(run["uncertainty"])}
    if "uncertainty_budget" in run:
        parts = run["uncertainty_budget"]
        left = parts[parts["evaluation"] == "not evaluated"]
        reported["not_in_budget"] = _rows(left[["result", "input_source", "reason"]])
    return reported


def _rows(table: pd.DataFrame) -> list[TableRow]:
    """Return rows for JSON, with null for missing or infinite numbers."""
    rows: list[TableRow] = json.loads(table.to_json(orient="records", double_precision=15))
    return rows
