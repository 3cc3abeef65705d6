"""Where loads move the platform: six components per load case, from readings of one channel at a time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask
from truing.estimation.interferometry.load_run import at_starts, begun_far, branches, start_rows
from truing.estimation.interferometry.recorded_steps import RecordedSteps
from truing.estimation.interferometry.run_curves import RunCurves, run_curves

_RELATIVE = 1e-10  # eigenvalue of the information, its diagonal scaled to one, below which a direction is unknown
BRANCHES = ("unloading", "unloaded", "loading")
# Of the largest load of its axis: loads that differ by less are the same.
_SAME = 1e-6


@dataclass(frozen=True)
class PlatformDisplacement:
    """Displacements of K load cases: dx, dy, dz in m and the rotation vector in rad.

    value (K, 6) NaN where unknown; covariance (K, 6, 6), infinite on the diagonal where unknown and zero beside it;
    known (K, 6). shared (Z,) and shared_covariance (Z, Z): the errors that cases share, as found; gain (K, 6, Z): how
    they move a case.
    chi_square and dof of readings that say the same thing twice.
    """

    value: Array
    covariance: Array
    known: Mask
    shared: Array
    shared_covariance: Array
    gain: Array
    chi_square: float
    dof: int

    def between(self, first: int, second: int) -> Array:
        """Covariance (6, 6) of two different cases: that of the errors which both share; zero where unknown."""
        return self.gain[first] @ self.shared_covariance @ self.gain[second].T


def zero_columns(run: Index) -> Array:
    """Return columns (N, G) of the zeros that readings of runs 0 .. G-1 count from."""
    return (np.asarray(run)[:, None] == np.arange(int(np.max(run, initial=-1)) + 1)).astype(float)


def drift_columns(run: Index, time_s: ArrayLike) -> Array:
    """Return columns (N, G) of the drifts of runs 0 .. G-1, per second since the first reading of each."""
    member = zero_columns(run)
    time = np.asarray(time_s, float)
    begin = np.min(np.where(member > 0.0, time[:, None], np.inf), axis=0, initial=np.inf)
    return member * (time[:, None] - np.where(np.isfinite(begin), begin, 0.0))


def platform_displacement(
    rows: Array,
    reading: ArrayLike,
    sigma: ArrayLike,
    case: Index,
    shared: Array,
    shared_sigma: ArrayLike,
) -> PlatformDisplacement:
    """Join readings (N,) with noise sigma (N,) to displacements of the cases 0 .. K-1 that they belong to (N,).

    rows (N, 6): how a reading follows the displacement (``recorded_steps.linear_rows``, ``angular_rows``); shared (N,
    Z): the errors that readings of several cases have in common (``zero_columns``, ``drift_columns``), with the
    standard deviations shared_sigma (Z,) that are known of them, infinite where nothing is. What the channels of a case
    do not determine stays unknown; nothing is taken from other cases. NaN readings take no part. Raises ValueError for
    shapes that do not agree, and for shared errors of which neither readings nor their sigma say anything.
    """
    rows, y, shared = np.asarray(rows, float), np.asarray(reading, float), np.asarray(shared, float)
    if rows.shape != (len(y), 6) or len(case) != len(y) or shared.ndim != 2 or len(shared) != len(y):
        raise ValueError(
            f"rows {rows.shape}, case {case.shape} and shared {shared.shape} of {len(y)} readings: "
            f"expected (N, 6), (N,) and (N, Z)"
        )
    seen = np.isfinite(y)
    cases = int(case.max(initial=-1)) + 1
    weight = np.where(seen, 1.0 / np.broadcast_to(np.asarray(sigma, float), y.shape), 0.0)
    white, measured, common = rows * weight[:, None], weight * np.where(seen, y, 0.0), shared * weight[:, None]
    information, coupling = np.zeros((cases, 6, 6)), np.zeros((cases, 6, shared.shape[1]))
    right = np.zeros((cases, 6))
    np.add.at(information, case, white[:, :, None] * white[:, None, :])
    np.add.at(coupling, case, white[:, :, None] * common[:, None, :])
    np.add.at(right, case, white * measured[:, None])
    inverse, known, rank = _inverse_where_known(information)
    # the shared errors are eliminated last: what tells of them is what the cases leave over, and what is known before
    held = inverse @ coupling
    prior = np.broadcast_to(np.asarray(shared_sigma, float), shared.shape[1:]) ** -2.0
    shared_information = common.T @ common + np.diag(prior) - np.einsum("kiz,kiy->zy", coupling, held)
    shared_covariance = _inverse_of_shared(shared_information)
    offset = shared_covariance @ (common.T @ measured - np.einsum("kiz,ki->z", held, right))
    value = np.einsum("kij,kj->ki", inverse, right) - held @ offset
    covariance = inverse + held @ shared_covariance @ np.swapaxes(held, 1, 2)
    left = measured - np.einsum("ni,ni->n", white, value[case]) - common @ offset
    both = known[:, :, None] & known[:, None, :]
    covariance = np.where(both, covariance, np.where(np.eye(6, dtype=bool), np.inf, 0.0))
    return PlatformDisplacement(
        np.where(known, value, np.nan),
        covariance,
        known,
        offset,
        shared_covariance,
        np.where(known[..., None], held, 0.0),
        float(left @ left + np.sum(prior * offset**2)),
        int(seen.sum() - rank.sum() - np.sum(prior == 0.0)),
    )


def _inverse_of_shared(information: Array) -> Array:
    """Inverse (Z, Z) of the information on the shared errors."""
    scale = np.sqrt(np.where(np.diag(information) > 0.0, np.diag(information), 1.0))
    scaled = information / np.outer(scale, scale)
    if len(information) and np.linalg.eigvalsh(scaled)[0] < _RELATIVE:
        raise ValueError("shared errors: found some that no reading tells of, expected a finite shared_sigma for them")
    return np.linalg.inv(scaled) / np.outer(scale, scale)


def _inverse_where_known(information: Array) -> tuple[Array, Mask, Index]:
    """Pseudo-inverses (K, 6, 6), which components (K, 6) lie wholly in what is known, and its rank (K,)."""
    size = np.sqrt(np.einsum("kii->ki", information))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(information / (scale[:, :, None] * scale[:, None, :]))
    kept = values > _RELATIVE
    inverse = np.einsum("kie,ke,kje->kij", vectors, kept / np.where(kept, values, 1.0), vectors)
    lost = np.einsum("kie,ke->ki", vectors**2, ~kept)
    known = (lost < _RELATIVE) & (size > 0.0)
    return inverse / (scale[:, :, None] * scale[:, None, :]), known, kept.sum(1)


@dataclass(frozen=True)
class EstimatedMotion:
    """Motions (K, 6), NaN where unknown, with covariance (K, 6, 6), infinite there; what the geometry of the beams adds
    to readings (K, 6), and one sigma of that, which goes with the load as it does itself: NaN where unknown."""

    value: Array
    covariance: Array
    added: Array
    added_sigma: Array


class DeclaredBeams(Protocol):
    """How beams see the platform as declared."""

    def solved(self, load: Array, read: Array, covariance: Array) -> EstimatedMotion:
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
    geometry: EstimatedMotion | None = None


def find_poses(steps: RecordedSteps, beams: DeclaredBeams | None, kept: Mask) -> PlatformPoses:
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
    steps: RecordedSteps, cases: LoadCases, sigma: Array, rows: Index, k: int
) -> tuple[PlatformDisplacement, Index, Mask]:
    """Displacements by one channel, its runs, and which of them tell their own drift: they came back to a load.

    The zero of a run is one reading. Nothing is known of its drift before.
    """
    met, run = np.unique(steps.run[rows], return_inverse=True)
    time, case = steps.time_s[rows], cases.of_step[rows]
    zeros, drifts = zero_columns(run), drift_columns(run, time)
    largest = np.abs(drifts).max(axis=0)
    drifting = np.array([_revisits_a_case(case[run == r], time[run == r]) for r in range(len(met))])
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


def _revisits_a_case(case: Index, time: Array) -> bool:
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

    of_step: Index
    load: Array
    branch: Index
    held_out: Mask
    branch_of_step: Index


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
