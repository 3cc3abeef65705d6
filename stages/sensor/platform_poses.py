"""Displacement of the platform under load: six components per load case, from readings of single channels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index, Mask
from truing.estimation.interferometry.platform_poses import BRANCHES, PlatformPoses, find_poses
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, READING_SI, READING_UNITS, RecordedSteps
from truing.report.numbers import count_text, gross_errors
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.bench.known_readings import BeamGeometry
from truing.stages.common.declared_optics import beam_optics
from truing.stages.common.manual_decisions import (
    ManualDecisions,
    excluded_words,
    exclusion_row,
    manual_decisions,
    matched,
    without_excluded,
)
from truing.stages.common.nominal_sensor import simulated_compliance
from truing.stages.common.point_arrays import decisions
from truing.stages.common.reading_arrays import LOAD_COLUMNS, MOVED_COLUMNS, MOVED_SI, load_steps
from truing.stages.common.rows import Rows
from truing.stages.declaration import Outcome

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign


GROSS = "gross error"
_HOUR = 3600.0


def platform_poses(tables: Mapping[str, pa.Table], settings: Campaign) -> Outcome:
    """The tables of the pose stage: displacement, reading_residuals, run_terms."""
    if "readings" not in tables or not tables["readings"].num_rows:
        empty = {name: ARTIFACTS[name].empty() for name in ("displacement", "reading_residuals", "run_terms")}
        return Outcome.not_evaluated(empty, "no readings of displacement")
    beams, geometry = settings.interferometer.beams, None
    if not beams.are_plain:
        geometry = BeamGeometry(beam_optics(beams), simulated_compliance(settings, tables.get("given_compliance")))
    steps_of_all = load_steps({"readings": tables["readings"]})
    steps, out = without_excluded(steps_of_all, settings)
    kept = manual_decisions(steps, settings.keep, "kept")
    poses = find_poses(steps, geometry, kept.readings)
    steps, identifier = poses.steps, "int64" if isinstance(poses.steps.runs[0], int) else "string"
    artifacts = {
        "displacement": _displacement_rows(poses, out).table(identifier),
        "reading_residuals": _residual_rows(poses, steps_of_all, out, kept).table(identifier),
        "run_terms": _term_rows(poses).table(identifier),
    }
    if out.readings.any():
        artifacts["exclusion_effects"] = _exclusion_rows(poses, steps_of_all, geometry, settings).table()
    count = int(np.isfinite(steps.reading).sum())
    read = f"{count_text(count, 'reading')} of {count_text(len(steps.runs), 'run')}"
    read += f" in {count_text(len(poses.value), 'load case')}"
    left_out = "; ".join(filter(None, (_left_out(poses), excluded_words(out)))) or "no reading"
    return Outcome(artifacts, read=read, left_out=left_out, figure=_figure(poses))


def _displacement_rows(platform: PlatformPoses, out: ManualDecisions) -> Rows:
    cases, rows = platform.cases, Rows("displacement")
    used, rejected = (np.zeros(len(cases.load), np.int64) for _ in range(2))
    is_observed = np.isfinite(platform.steps.reading)
    np.add.at(used, cases.of_step, (is_observed & ~platform.curves.rejected).sum(1))
    np.add.at(rejected, cases.of_step, (platform.curves.rejected | out.readings).sum(1))
    known = np.isfinite(platform.value)
    covariance = np.where(known[:, :, None] & known[:, None] | np.eye(6, dtype=bool), platform.covariance, np.nan)
    covariance = np.where(np.isfinite(covariance), covariance, np.nan)
    entries = {f"cov_{i}_{j}": covariance[:, i, j] for i in range(6) for j in range(i, 6)}
    roles = {"role": np.where(cases.held_out, "verification", "calibration")} if cases.held_out.any() else {}
    rows.add(
        case=np.arange(1, len(cases.load) + 1),
        branch=[BRANCHES[branch] for branch in cases.branch],
        **dict(zip(LOAD_COLUMNS, cases.load.T, strict=True)),
        **dict(zip(MOVED_COLUMNS, (platform.value / MOVED_SI).T, strict=True)),
        **entries,
        n_used=used,
        n_rejected=rejected,
        **roles,
    )
    return rows


def _residual_rows(
    platform: PlatformPoses, recorded: RecordedSteps, out: ManualDecisions, kept: ManualDecisions
) -> Rows:
    """Return one row per reading, including readings of ``recorded`` that a person excluded."""
    steps, curves, rows = platform.steps, platform.curves, Rows("reading_residuals")
    at, k = np.nonzero(np.isfinite(recorded.reading))
    rejected, residual = (curves.rejected | out.readings)[at, k], curves.residual[at, k] / READING_SI[k]
    sigma = curves.sigma[at, k] / READING_SI[k]
    spoken = out.words + kept.words
    reasons = [
        text or (f"{GROSS}: {abs(r) / s:.0f} sigma off its run's curve" if gross else None)
        for text, gross, r, s in zip(spoken[at, k], rejected, residual, sigma, strict=True)
    ]
    rows.add(
        run=[steps.runs[r] for r in steps.run[at]],
        step=steps.step[at],
        channel=[CHANNELS[j] for j in k],
        branch=[BRANCHES[branch] for branch in platform.cases.branch_of_step[at]],
        residual=residual,
        sigma=sigma,
        unit=[READING_UNITS[j] for j in k],
        weight=np.where(rejected, 0.0, 1.0),
        rejected=rejected,
        reason=reasons,
        decision=decisions(out.readings, kept.readings)[at, k],
        **_geometry_columns(platform, at, k),
    )
    return rows


def _exclusion_rows(
    platform: PlatformPoses, steps: RecordedSteps, geometry: BeamGeometry | None, settings: Campaign
) -> Rows:
    """Return the change of the displacements by a person's exclusions; one row per [[exclude]] and channel."""
    with_all = find_poses(steps, geometry, manual_decisions(steps, settings.keep, "kept").readings)
    change = np.abs(with_all.value - platform.value) / READING_SI
    over = np.abs(with_all.value - platform.value) / np.sqrt(np.einsum("kii->ki", with_all.covariance))
    rows = Rows("exclusion_effects")
    for number, rule in enumerate(settings.exclude, 1):
        chosen = matched(steps, rule)[:, : len(CHANNELS)] & np.isfinite(steps.reading)
        for k in np.flatnonzero(chosen.any(axis=0)):
            rows.add(
                **exclusion_row(number, rule, f"channel {CHANNELS[k]}", change[:, k], over[:, k]),
                rows=int(chosen[:, k].sum()),
                gross_anyway=int((with_all.curves.rejected & chosen)[:, k].sum()),
                unit=READING_UNITS[k],
            )
    return rows


def _geometry_columns(platform: PlatformPoses, at: Index, k: Index) -> dict[str, Array]:
    if platform.geometry is None:
        return {}
    index = platform.cases.of_step[at], k
    parts = {"geometry": platform.geometry.added, "geometry_sigma": platform.geometry.added_sigma}
    return {name: values[index] / READING_SI[k] for name, values in parts.items()}


def _term_rows(platform: PlatformPoses) -> Rows:
    from scipy.special import ndtr

    rows = Rows("run_terms")
    parts = (
        ("zero", platform.zero, platform.zero_sigma, 1.0, ""),
        ("drift", platform.drift, platform.drift_sigma, _HOUR, "/h"),
    )
    for name, value, sigma, factor, per in parts:
        r, k = np.nonzero(np.isfinite(value))
        if len(r):
            scale = factor / READING_SI[k]
            rows.add(
                run=[platform.steps.runs[i] for i in r],
                channel=[CHANNELS[j] for j in k],
                term=name,
                value=value[r, k] * scale,
                sigma=sigma[r, k] * scale,
                unit=[READING_UNITS[j] + per for j in k],
                p_value=2.0 * ndtr(-np.abs(value[r, k] / sigma[r, k])),
            )
    return rows


def _left_out(platform: PlatformPoses) -> str:
    at, k = np.nonzero(platform.curves.rejected)
    if not len(at):
        return ""
    steps = platform.steps
    rows = zip(k, steps.run[at], steps.step[at], strict=True)
    named = [f"{CHANNELS[j]} of run {steps.runs[run]} step {step}" for j, run, step in rows]
    more = f" and {len(named) - 3} more" if len(named) > 3 else ""
    return f"{gross_errors(len(named), 'reading')}: {', '.join(named[:3])}{more}"


def _figure(platform: PlatformPoses) -> str:
    known = np.isfinite(platform.value)
    ever = np.asarray(known.any(axis=0))
    never = [name for name, seen in zip(CHANNELS, ever, strict=True) if not seen]
    words = f"{int(known.all(1).sum())} of {len(known)} load cases in all six components{_corrected(platform)}"
    missing = [
        f"{axis} {' '.join(np.array(CHANNELS)[~seen])}"
        for axis, seen in _steps_by_axis(platform).items()
        if not seen.all() and seen.any() and not never
    ]
    if never:
        return f"{words}; never measured: {', '.join(never)}"
    return f"{words}; not measured under {'; '.join(missing)}" if missing else words


def _corrected(platform: PlatformPoses) -> str:
    """Return the largest change of each channel by the declared beam geometry, in words."""
    if platform.geometry is None:
        return ""
    most = np.nanmax(np.abs(platform.geometry.added / READING_SI), axis=0, initial=0.0)
    texts = [f"{name} by {m:.2g} {u}" for name, m, u in zip(CHANNELS, most, READING_UNITS, strict=True) if m > 0.0]
    return f"; corrected for the geometry of beams: {', '.join(texts)} at most" if texts else ""


def _steps_by_axis(platform: PlatformPoses) -> dict[str, Mask]:
    """Return the mask of known components by axis of load, for axes that were loaded alone."""
    alone = platform.cases.load != 0.0
    alone &= alone.sum(1, keepdims=True) == 1
    known = np.isfinite(platform.value)
    return {LOADS[a]: known[alone[:, a]].any(0) for a in range(6) if alone[:, a].any()}
