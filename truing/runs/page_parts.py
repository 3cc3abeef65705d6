"""Head and sections of a run's page, from its tables alone; used by the report stage and by notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from truing.report.page import NO_FACTS

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from truing.report.page import CampaignFacts, PageHead, ReportSection


_PREFIX = b"truing."
_TURN = ["rx_rad", "ry_rad", "rz_rad"]
_PLACE = ["px_mm", "py_mm", "pz_mm"]
_ENTRIES = [f"r{i}{j}" for i in range(3) for j in range(3)]
_XYZ = ["x_mm", "y_mm", "z_mm"]
_SHIFT = ["dx_mm", "dy_mm", "dz_mm"]
_TARGET_COLUMNS = ["body", "target", *_XYZ, "leg"]


def provenance_of(schema: pa.Schema) -> dict[str, str]:
    """Return the provenance in the metadata of a table's schema: stage, digest, version, campaign, units, remarks of
    its stage."""
    metadata = schema.metadata or {}
    return {k[len(_PREFIX) :].decode(): v.decode() for k, v in metadata.items() if k.startswith(_PREFIX)}


def page_parts(
    campaign: str,
    tables: Mapping[str, pa.Table],
    legs: pd.DataFrame | None = None,
    declared_noise: pd.DataFrame | None = None,
    about: CampaignFacts = NO_FACTS,
) -> tuple[PageHead, list[ReportSection]]:
    """Return the head and the sections of the page for tables by artifact name; a missing verdict is computed.

    ``legs`` (leg, ax_mm .. az_mm, bx_mm .. bz_mm): joints of a sensor in its platform's frame; ``declared_noise``
    (signal_mv, NaN where none is declared). No table holds these, nor the facts in ``about``.
    """
    from truing.report.comments import with_comments
    from truing.report.page_head import build_head
    from truing.report.sections import build_sections
    from truing.report.verdict import with_verdict
    from truing.runs.chain_positions import chain_positions

    provenance = {name: provenance_of(table.schema) for name, table in tables.items()}
    frames = _frames(tables)
    frames |= with_verdict(frames)
    targets = target_positions_of(frames)
    if targets is not None:
        frames["shape"] = targets
    motions = _body_motions(frames)
    if motions is not None:
        frames["motions"] = motions
    frames |= chain_positions(frames)
    if legs is not None:
        frames["legs"] = legs
    if declared_noise is not None:
        frames["declared_noise"] = declared_noise
    head = build_head(campaign, frames, about)
    return head, with_comments(build_sections(frames, provenance, about), about.comments)


def verdict_table(tables: Mapping[str, pa.Table]) -> pa.Table:
    """Return the artifact ``verdict`` of tables by artifact name."""
    from truing.report.verdict import verdict_frame

    return _as_artifact("verdict", verdict_frame(_frames(tables)))


def next_measurements_table(tables: Mapping[str, pa.Table]) -> pa.Table:
    """Return the artifact ``next_measurements`` of tables by artifact name."""
    from truing.report.diagnosis.assessed_causes import assessed_causes
    from truing.report.diagnosis.next_steps import next_measurements_frame, next_steps

    frames = _frames(tables)
    return _as_artifact("next_measurements", next_measurements_frame(next_steps(assessed_causes(frames), frames)))


def _as_artifact(name: str, rows: pd.DataFrame) -> pa.Table:
    import pyarrow as pa

    from truing.schemas.artifacts import ARTIFACTS

    artifact, cells = ARTIFACTS[name], rows.astype(object)
    records = cells.where(cells.notna(), None).to_dict("records")
    return pa.Table.from_pylist(records, schema=artifact.arrow_schema(present=artifact.optional))


def _frames(tables: Mapping[str, pa.Table]) -> dict[str, pd.DataFrame]:
    """Return the tables as data frames, each with the reason, as an attribute, if its stage was not evaluated."""
    import pandas

    from truing.report.tables import WHY_NOT

    # Tables of a page are short: texts as Python objects cost less than a call of Arrow for each step.
    with pandas.option_context("mode.string_storage", "python"):
        frames = {name: table.to_pandas() for name, table in tables.items()}
    for name, frame in frames.items():  # only the reason, because pandas copies attributes with every step
        if why := provenance_of(tables[name].schema).get(WHY_NOT, ""):
            frame.attrs[WHY_NOT] = why
    return frames


def _body_motions(frames: Mapping[str, pd.DataFrame]) -> pd.DataFrame | None:
    """Return columns pose, body, parent, px_mm .. pz_mm, and r00 .. r22 of x_parent = R x + p; None without poses."""
    poses = frames.get("poses")
    if poses is None or not len(poses):
        return None
    from truing.estimation.rotation import exp_so3

    chosen = poses[poses["default"] & (poses["status"] == "ok")]
    turns = exp_so3(chosen[_TURN].to_numpy(dtype=float)).reshape(-1, 9)
    motions = chosen[["pose", "body", "parent", *_PLACE]].reset_index(drop=True)
    return motions.assign(**dict(zip(_ENTRIES, np.asarray(turns).T, strict=True)))


def target_positions_of(frames: Mapping[str, pd.DataFrame]) -> pd.DataFrame | None:
    """Return columns body, target, x_mm, y_mm, z_mm, leg from the survey or the poses; None without both."""
    survey = frames.get("survey")
    if survey is not None and len(survey):
        return survey[_TARGET_COLUMNS]
    if not all(len(frames.get(name, ())) for name in ("observations", "poses", "residuals")):
        return None
    return _averages(frames["observations"], frames["poses"], frames["residuals"])


def _averages(observations: pd.DataFrame, poses: pd.DataFrame, residuals: pd.DataFrame) -> pd.DataFrame:
    """Return the mean places of measured points in the frame of their body, without residuals."""
    chosen = poses[poses["default"] & (poses["status"] == "ok")]
    bases = chosen[["pose", "body", *_PLACE, *_TURN]].rename(columns={"body": "parent"})
    residuals_used = residuals[~residuals["rejected"]].dropna(subset=_SHIFT)
    points = observations.merge(residuals_used, on=["pose", "body", "target"]).merge(chosen, on=["pose", "body"])
    points = points.merge(bases, on=["pose", "parent"], how="left", suffixes=("", "_of_parent"))
    position = points[_XYZ].to_numpy(dtype=float)
    seen_directly = (points["parent"] == "measurement").to_numpy()
    position = np.where(seen_directly[:, None], position, _in_frames_of(position, points, "_of_parent"))
    position = _in_frames_of(position, points, "") - points[_SHIFT].to_numpy(dtype=float)
    shifts = points[["body", "target"]].assign(**dict(zip(_XYZ, position.T, strict=True)))
    means = shifts.groupby(["body", "target"], sort=False)[_XYZ].mean().reset_index().dropna()
    return means.assign(leg=np.nan)[_TARGET_COLUMNS]


def _in_frames_of(position: np.ndarray, poses: pd.DataFrame, suffix: str) -> np.ndarray:
    """Return points (N, 3), given in the parent's frame, in the frames of N bodies."""
    from truing.estimation.rotation import exp_so3

    turn = poses[[f"{c}{suffix}" for c in _TURN]].to_numpy(dtype=float)
    origin = poses[[f"{c}{suffix}" for c in _PLACE]].to_numpy(dtype=float)
    return np.einsum("nji,nj->ni", exp_so3(turn), position - origin)
