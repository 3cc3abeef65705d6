"""What rays told, among the rows of what was found in points."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.numbers import two_decimals
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.diagnosis.detectable_rows import detectable_table, detectable_words
from truing.stages.diagnosis.ray_findings import SHARE_OF_RAYS
from truing.stages.diagnosis.ray_points import RayShown
from truing.stages.diagnosis.rows import Words, diagnosis_table
from truing.stages.diagnosis.uncertainty_rows import uncertainty_table

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.selection import Settings
    from truing.stages.diagnosis.ray_findings import RayFindings

_ORDER = ("found", "indistinguishable", "rejected")
_UM = 1e6


def with_rays(artifacts: Mapping[str, Any], rays: RayFindings, rule: Settings) -> dict[str, Any]:
    """The artifacts of a diagnosis of points, with what rays told before them; ``rule`` is the whole campaign's."""
    diagnosis, found = rays.diagnosis, dict(artifacts)
    level, noise_level = SHARE_OF_RAYS * rule.level, SHARE_OF_RAYS * rule.noise_level
    words = detectable_words(diagnosis.search, level, [verdict.cause for verdict in diagnosis.verdicts], 0)
    own = diagnosis_table(diagnosis, Words(words, {}, "", RayShown()), noise_level).to_pylist()
    of_causes = [row for row in own if "noise_ratio" not in json.loads(row["parameters"])]
    for row, verdict in zip(of_causes, diagnosis.verdicts, strict=True):
        if verdict.cause.key in rays.moves and row["verdict"] == "found":
            row["explanation"] += _on_points(rays.moves[verdict.cause.key])
    found["diagnosis"] = _ranked(own, found["diagnosis"])
    for name, table in (
        ("detectable", detectable_table(diagnosis.search, level, 0)),
        ("cause_uncertainty", uncertainty_table(diagnosis, 0)),
    ):
        found[name] = _together(name, [found[name], table] if name in found else [table])
    return found


def _ranked(rays: list[dict[str, Any]], points: pa.Table) -> pa.Table:
    """All rows in the order of their verdicts, those of rays first; what either found is rejected by neither."""
    import pyarrow as pa

    rows = [*rays, *points.to_pylist()]
    told = {row["cause"] for row in rows if row["verdict"] != "rejected"}
    kept: list[dict[str, Any]] = []
    for verdict in _ORDER:
        of_verdict = [row for row in rows if row["verdict"] == verdict]
        if verdict == "rejected":
            of_verdict.sort(key=lambda row: -row["probability"])
            once = {row["cause"]: row for row in reversed(of_verdict) if row["cause"] not in told}
            of_verdict = [row for row in of_verdict if once.get(row["cause"]) is row]
        kept += of_verdict
    ranked = [{**row, "rank": rank} for rank, row in enumerate(kept, 1)]
    artifact = ARTIFACTS["diagnosis"]
    return pa.Table.from_pylist(ranked, schema=artifact.arrow_schema(present=artifact.optional))


def _on_points(moved: Any) -> str:
    """How far an effect moved the points that were computed from the rays."""
    size = np.linalg.norm(moved, axis=-1) * _UM
    return (
        f" It moved object points by up to {two_decimals(float(size.max(initial=0.0)))} um against each other, "
        f"{two_decimals(float(np.sqrt(np.mean(size**2))))} um rms; that is taken off before anything is looked for in "
        "them."
    )


def _together(name: str, tables: list[pa.Table]) -> pa.Table:
    import pyarrow as pa

    return pa.concat_tables(tables, promote_options="default").cast(ARTIFACTS[name].arrow_schema())
