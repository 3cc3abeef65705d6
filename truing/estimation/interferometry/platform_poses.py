"""Where loads move the platform: six components per load case, from readings of one channel at a time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.load_run import branches
from truing.estimation.interferometry.platform_displacement import (
    PlatformDisplacement,
    drift_columns,
    platform_displacement,
    zero_columns,
)
from truing.estimation.interferometry.recorded_steps import RecordedSteps
from truing.estimation.interferometry.run_curves import RunCurves, run_curves
from truing.estimation.interferometry.run_starts import at_starts, begun_far, start_rows

Mask = NDArray[np.bool_]
Array = NDArray[np.float64]
BRANCHES = ("unloading", "unloaded", "loading")
# Of the largest load of its axis: loads that differ by less are the same.
_SAME = 1e-6


@dataclass(frozen=True)
class SeenMotion:
    """Motions (K, 6), NaN where unknown, with covariance (K, 6, 6), infinite there; what the geometry of the beams adds
    to readings (K, 6), and one sigma of that, which goes with the load as it does itself: NaN where unknown."""

    value: Array
    covariance: Array
    added: Array
    added_sigma: Array


class Beams(Protocol):
    """How beams see the platform as declared."""

    def solved(self, load: Array, read: Array, covariance: Array) -> SeenMotion:
        """Return the motions of cases under loads (K, 6) by what their channels read (K, 6), NaN where nothing was."""


@dataclass(frozen=True)
class PlatformPoses:
    """Displacements of K cases, and the runs' terms that they are counted from.

    zero, drift (R, 6) and their sigmas, NaN where a run did not read a channel, or did not tell its drift; drift per s.
    geometry: what the declared geometry of beams made of the cases; None without any.
    """

    steps: RecordedSteps
    cases: LoadCases
    curves: RunCurves
    value: Array
    covariance: Array
    zero: Array
    zero_sigma: Array
    drift: Array
    drift_sigma: Array
    geometry: SeenMotion | None = None


def find_poses(steps: RecordedSteps, beams: Beams | None, kept: Mask) -> PlatformPoses:
    """Return displacements from readings joined, each channel by itself: their errors have nothing in common.

    What channels read are the platform's components, but for the declared geometry of their beams. ``kept`` (B, 6)
    are no gross errors, for a person says so.
    """
    cases = load_cases(steps)
    curves = run_curves(steps.load, steps.time_s, steps.run, steps.reading, steps.sigma)
    curves = replace(curves, rejected=curves.rejected & ~kept)
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
    found = PlatformPoses(steps, cases, curves, value, covariance, *terms)
    if beams is None:
        return found
    seen = beams.solved(cases.load, value, covariance)
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
