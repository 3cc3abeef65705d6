"""Where loads move the platform: six components per load case, from readings of one channel at a time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.common.overruled import Decided, decided, excluded_words, matched, without_excluded
from stages.common.point_arrays import decisions
from stages.common.reading_arrays import LOAD_COLUMNS, load_steps
from stages.common.rows import Rows
from stages.declaration import Outcome
from truing.estimation.interferometry.load_run import branches
from truing.estimation.interferometry.platform_displacement import (
    PlatformDisplacement,
    drift_columns,
    platform_displacement,
    zero_columns,
)
from truing.estimation.interferometry.recorded_steps import CHANNELS, LOADS, READING_SI, RecordedSteps
from truing.estimation.interferometry.run_curves import RunCurves, run_curves
from truing.estimation.interferometry.run_starts import at_starts, begun_far, start_rows
from truing.report.numbers import count as counted
from truing.simulation.bench.seen_motion import BeamGeometry, SeenMotion

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GROSS = "gross error"
_HOUR = 3600.0
_UNITS = ("um", "um", "um", "arcsec", "arcsec", "arcsec")
_MOVED = ("dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad")
_MOVED_UNIT = np.array([1e-3] * 3 + [1.0] * 3)
BRANCHES = ("unloading", "unloaded", "loading")
# Of the largest load of its axis: loads that differ by less are the same.
_SAME = 1e-6


@dataclass(frozen=True)
class PlatformPoses:
    """Displacements of K cases, and the runs' terms that they are counted from.

    zero, drift (R, 6) and their sigmas, NaN where a run did not read a channel, or did not tell its drift; drift per s.
    kept: by a person. geometry: what the declared geometry of beams made of the cases; None without any.
    """

    steps: RecordedSteps
    cases: LoadCases
    curves: RunCurves
    kept: Decided
    value: Array
    covariance: Array
    zero: Array
    zero_sigma: Array
    drift: Array
    drift_sigma: Array
    geometry: SeenMotion | None = None


def platform_poses(readings: pa.Table, geometry: BeamGeometry | None, settings: Campaign) -> Outcome:
    """The tables of the pose stage: displacement, reading_residuals, run_terms."""
    whole = load_steps({"readings": readings})
    steps, out = without_excluded(whole, settings)
    found = find_poses(steps, geometry, decided(steps, settings.keep, "kept"))
    steps, identifier = found.steps, "int64" if isinstance(found.steps.runs[0], int) else "string"
    tables = {
        "displacement": _displacement_rows(found, out).table(identifier),
        "reading_residuals": _residual_rows(found, whole, out).table(identifier),
        "run_terms": _term_rows(found).table(identifier),
    }
    if out.readings.any():
        tables["exclusion_effects"] = _exclusion_rows(found, whole, geometry, settings).table()
    count = int(np.isfinite(steps.reading).sum())
    read = f"{count} readings of {counted(len(steps.runs), 'run')} in {counted(len(found.value), 'load case')}"
    left_out = "; ".join(filter(None, (_left_out(found), excluded_words(out)))) or "no reading"
    return Outcome(tables, read=read, left_out=left_out, figure=_figure(found))


def find_poses(steps: RecordedSteps, geometry: BeamGeometry | None, kept: Decided) -> PlatformPoses:
    """Join readings to displacements, each channel by itself: their errors have nothing in common.

    What channels read are the platform's components, but for the declared geometry of their beams. ``kept`` are no
    gross errors, for a person says so.
    """
    cases = load_cases(steps)
    curves = run_curves(steps.load, steps.time_s, steps.run, steps.reading, steps.sigma)
    curves = replace(curves, rejected=curves.rejected & ~kept.readings)
    origin = _origins(steps, curves)
    counted = replace(steps, reading=steps.reading - origin[steps.run])
    count, runs = len(cases.load), len(steps.runs)
    value, covariance = np.full((count, 6), np.nan), np.zeros((count, 6, 6))
    terms = np.full((4, runs, 6), np.nan)
    for k in range(6):
        rows = np.flatnonzero(np.isfinite(steps.reading[:, k]) & ~curves.rejected[:, k])
        covariance[:, k, k] = np.inf
        if not len(rows):
            continue
        one, met, drifting = _of_channel(counted, cases, curves.sigma[rows, k], rows, k)
        value[: len(one.value), k], covariance[: len(one.value), k, k] = one.value[:, k], one.covariance[:, k, k]
        sigma = np.sqrt(np.diag(one.shared_covariance))
        terms[0, met, k], terms[1, met, k] = origin[met, k] + one.shared[: len(met)], sigma[: len(met)]
        terms[2, met[drifting], k], terms[3, met[drifting], k] = one.shared[len(met) :], sigma[len(met) :]
    found = PlatformPoses(steps, cases, curves, kept, value, covariance, *terms)
    if geometry is None:
        return found
    seen = geometry.solved(cases.load, value, covariance)
    return replace(found, value=seen.value, covariance=seen.covariance, geometry=seen)


def _origins(steps: RecordedSteps, curves: RunCurves) -> Array:
    """Where runs (R, 6) count from, m and rad: zero, but for what begins unloaded far from it, as coordinates do."""
    rows = start_rows(steps)
    start = at_starts(np.where(curves.rejected, np.nan, steps.reading), rows)
    return np.where(begun_far(start, at_starts(curves.sigma, rows)), start, 0.0)


def _of_channel(
    steps: RecordedSteps, cases: LoadCases, sigma: Array, rows: NDArray[np.int64], k: int
) -> tuple[PlatformDisplacement, NDArray[np.int64], Mask]:
    """Displacements by one channel, its runs, and which of them tell their own drift: they came back to a load.

    The zero of a run is one reading. Nothing is known of its drift before.
    """
    met, run = np.unique(steps.run[rows], return_inverse=True)
    time, case = steps.time_s[rows], cases.of_step[rows]
    zeros, drifts = zero_columns(run), drift_columns(run, time)
    largest = np.abs(drifts).max(axis=0)
    drifting = np.array([_comes_back(case[run == r], time[run == r]) for r in range(len(met))])
    scale = largest[drifting]
    first = np.array([sigma[run == r][0] for r in range(len(met))])
    shared = np.concatenate([zeros, drifts[:, drifting] / scale], axis=1)
    known = np.concatenate([first, np.full(int(drifting.sum()), np.inf)])
    along = np.broadcast_to(np.eye(6)[k], (len(rows), 6))
    found = platform_displacement(along, steps.reading[rows, k], sigma, case, shared, known)
    per_second = np.concatenate([np.ones(len(met)), 1.0 / scale])
    return _rescaled(found, per_second), met, drifting


def _rescaled(found: PlatformDisplacement, factor: Array) -> PlatformDisplacement:
    covariance = found.shared_covariance * np.outer(factor, factor)
    return replace(found, shared=found.shared * factor, shared_covariance=covariance, gain=found.gain / factor)


def _comes_back(case: NDArray[np.int64], time: Array) -> bool:
    """Whether a run visits a load case at two times at least."""
    visits = np.unique(case, return_inverse=True)[1]
    low, high = np.full(visits.max() + 1, np.inf), np.full(visits.max() + 1, -np.inf)
    np.minimum.at(low, visits, time)
    np.maximum.at(high, visits, time)
    return bool(np.any(high > low))


def _displacement_rows(found: PlatformPoses, out: Decided) -> Rows:
    cases, rows = found.cases, Rows("displacement")
    used, rejected = (np.zeros(len(cases.load), np.int64) for _ in range(2))
    seen = np.isfinite(found.steps.reading)
    np.add.at(used, cases.of_step, (seen & ~found.curves.rejected).sum(1))
    np.add.at(rejected, cases.of_step, (found.curves.rejected | out.readings).sum(1))
    variance = np.where(np.isfinite(found.covariance), found.covariance, np.nan)
    entries = {f"cov_{i}_{j}": variance[:, i, j] for i in range(6) for j in range(i, 6)}
    known = np.isfinite(found.value)
    for i, j in zip(*np.triu_indices(6, 1), strict=True):
        entries[f"cov_{i}_{j}"] = np.where(known[:, i] & known[:, j], entries[f"cov_{i}_{j}"], np.nan)
    roles = {"role": np.where(cases.held_out, "verification", "calibration")} if cases.held_out.any() else {}
    rows.add(
        case=np.arange(1, len(cases.load) + 1),
        branch=[BRANCHES[way] for way in cases.branch],
        **dict(zip(LOAD_COLUMNS, cases.load.T, strict=True)),
        **dict(zip(_MOVED, (found.value / _MOVED_UNIT).T, strict=True)),
        **entries,
        n_used=used,
        n_rejected=rejected,
        **roles,
    )
    return rows


def _residual_rows(found: PlatformPoses, whole: RecordedSteps, out: Decided) -> Rows:
    """A row per reading, those of ``whole`` that a person left out among them."""
    steps, curves, rows = found.steps, found.curves, Rows("reading_residuals")
    at, k = np.nonzero(np.isfinite(whole.reading))
    rejected, residual = (curves.rejected | out.readings)[at, k], curves.residual[at, k] / READING_SI[k]
    sigma = curves.sigma[at, k] / READING_SI[k]
    spoken = out.words + found.kept.words
    reasons = [
        said or (f"{GROSS}: {abs(r) / s:.0f} sigma off its run's curve" if gross else None)
        for said, gross, r, s in zip(spoken[at, k], rejected, residual, sigma, strict=True)
    ]
    rows.add(
        run=[steps.runs[r] for r in steps.run[at]],
        step=steps.step[at],
        channel=[CHANNELS[j] for j in k],
        branch=[BRANCHES[way] for way in found.cases.branch_of_step[at]],
        residual=residual,
        sigma=sigma,
        unit=[_UNITS[j] for j in k],
        weight=np.where(rejected, 0.0, 1.0),
        rejected=rejected,
        reason=reasons,
        decision=decisions(out.readings, found.kept.readings)[at, k],
        **_geometry_columns(found, at, k),
    )
    return rows


def _exclusion_rows(
    found: PlatformPoses, whole: RecordedSteps, geometry: BeamGeometry | None, settings: Campaign
) -> Rows:
    """What a person's exclusions change: the displacements once more, of all readings; a row per [[exclude]] and
    channel."""
    with_all = find_poses(whole, geometry, decided(whole, settings.keep, "kept"))
    change = np.abs(with_all.value - found.value) / READING_SI
    over = np.abs(with_all.value - found.value) / np.sqrt(np.einsum("kii->ki", with_all.covariance))
    rows = Rows("exclusion_effects")
    for number, rule in enumerate(settings.exclude, 1):
        chosen = matched(whole, rule)[:, : len(CHANNELS)] & np.isfinite(whole.reading)
        for k in np.flatnonzero(chosen.any(axis=0)):
            told = np.isfinite(change[:, k])
            rows.add(
                entry=f"exclude {number}",
                subject=f"channel {CHANNELS[k]}",
                by=rule.by,
                decided_on=None if rule.on is None else str(rule.on),
                reason=rule.reason,
                rows=int(chosen[:, k].sum()),
                gross_anyway=int((with_all.curves.rejected & chosen)[:, k].sum()),
                largest_change=float(change[told, k].max()) if told.any() else None,
                unit=_UNITS[k],
                over_sigma=float(over[told, k].max()) if told.any() else None,
            )
    return rows


def _geometry_columns(found: PlatformPoses, at: NDArray[np.int64], k: NDArray[np.int64]) -> dict[str, Array]:
    if found.geometry is None:
        return {}
    places = found.cases.of_step[at], k
    parts = {"geometry": found.geometry.added, "geometry_sigma": found.geometry.added_sigma}
    return {name: values[places] / READING_SI[k] for name, values in parts.items()}


def _term_rows(found: PlatformPoses) -> Rows:
    from scipy.special import ndtr

    rows = Rows("run_terms")
    parts = (("zero", found.zero, found.zero_sigma, 1.0, ""), ("drift", found.drift, found.drift_sigma, _HOUR, "/h"))
    for name, value, sigma, factor, per in parts:
        r, k = np.nonzero(np.isfinite(value))
        if len(r):
            scale = factor / READING_SI[k]
            rows.add(
                run=[found.steps.runs[i] for i in r],
                channel=[CHANNELS[j] for j in k],
                term=name,
                value=value[r, k] * scale,
                sigma=sigma[r, k] * scale,
                unit=[_UNITS[j] + per for j in k],
                p_value=2.0 * ndtr(-np.abs(value[r, k] / sigma[r, k])),
            )
    return rows


def _left_out(found: PlatformPoses) -> str:
    at, k = np.nonzero(found.curves.rejected)
    if not len(at):
        return ""
    steps = found.steps
    places = zip(k, steps.run[at], steps.step[at], strict=True)
    named = [f"{CHANNELS[j]} of run {steps.runs[run]} step {step}" for j, run, step in places]
    more = f" and {len(named) - 3} more" if len(named) > 3 else ""
    return f"{len(named)} readings as gross errors: {', '.join(named[:3])}{more}"


def _figure(found: PlatformPoses) -> str:
    known = np.isfinite(found.value)
    ever = np.asarray(known.any(axis=0))
    never = [name for name, seen in zip(CHANNELS, ever, strict=True) if not seen]
    words = f"{int(known.all(1).sum())} of {len(known)} load cases in all six components{_corrected(found)}"
    missing = [
        f"{axis} {' '.join(np.array(CHANNELS)[~seen])}"
        for axis, seen in _by_axis(found).items()
        if not seen.all() and seen.any() and not never
    ]
    if never:
        return f"{words}; never measured: {', '.join(never)}"
    return f"{words}; not measured under {'; '.join(missing)}" if missing else words


def _corrected(found: PlatformPoses) -> str:
    """By how much the declared geometry of beams changed each channel, at most."""
    if found.geometry is None:
        return ""
    most = np.nanmax(np.abs(found.geometry.added / READING_SI), axis=0, initial=0.0)
    said = [f"{name} by {m:.2g} {u}" for name, m, u in zip(CHANNELS, most, _UNITS, strict=True) if m > 0.0]
    return f"; corrected for the geometry of beams: {', '.join(said)} at most" if said else ""


def _by_axis(found: PlatformPoses) -> dict[str, Mask]:
    """Which channels were read under each axis of load that was loaded by itself."""
    alone = found.cases.load != 0.0
    alone &= alone.sum(1, keepdims=True) == 1
    known = np.isfinite(found.value)
    return {LOADS[a]: known[alone[:, a]].any(0) for a in range(6) if alone[:, a].any()}


@dataclass(frozen=True)
class LoadCases:
    """K load cases: which one each of B steps belongs to, the loads (K, 6), the branch (K,) of BRANCHES, and whether
    nothing may be fitted to it (K,). ``branch_of_step`` (B,)."""

    of_step: NDArray[np.int64]
    load: Array
    branch: NDArray[np.int64]
    held_out: NDArray[np.bool_]
    branch_of_step: NDArray[np.int64]


def load_cases(steps: RecordedSteps) -> LoadCases:
    """The load cases in order of appearance; without load there is but one, whatever came before."""
    scale = np.abs(steps.load).max(axis=0, initial=0.0)
    share = np.round(steps.load / np.where(scale > 0.0, scale, 1.0) / _SAME)
    way = np.zeros(len(share), np.int64)
    for run in range(len(steps.runs)):
        way[steps.run == run] = branches(share[steps.run == run])
    branch = np.where((share == 0.0).all(axis=1), 1, np.where(way < 0, 0, 2))
    kind = np.column_stack([share, branch, steps.held_out])
    _, first, number = np.unique(kind, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.argsort(order)
    first = first[order]
    return LoadCases(place[number.ravel()], steps.load[first], branch[first], steps.held_out[first], branch)
