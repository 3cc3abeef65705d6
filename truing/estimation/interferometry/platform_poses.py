"""Displacements of a platform under load: six components per load case, from readings of single channels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from truing.arrays import Array, Index, Mask
from truing.estimation.interferometry.load_run import at_starts, branches, start_rows, starts_far_from_zero
from truing.estimation.interferometry.recorded_steps import RecordedSteps
from truing.estimation.interferometry.run_curves import RunCurves, run_curves

_RELATIVE = 1e-10  # least eigenvalue of the scaled information for a determined direction
BRANCHES = ("unloading", "unloaded", "loading")
# Relative to the largest load of its axis: loads with a smaller difference are equal.
_SAME = 1e-6


@dataclass(frozen=True)
class PlatformDisplacement:
    """Displacements of K load cases: dx, dy, dz in m and the rotation vector in rad.

    value (K, 6): NaN if unknown; covariance (K, 6, 6): infinite diagonal and zero elsewhere if unknown; known (K, 6).
    shared (Z,) and shared_covariance (Z, Z): estimated errors common to cases; gain (K, 6, Z): their effect on each
    case. chi_square and dof of redundant readings.
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
        """Return the covariance (6, 6) between two different cases, due to shared errors; zero if unknown."""
        return self.gain[first] @ self.shared_covariance @ self.gain[second].T


def zero_columns(run: Index) -> Array:
    """Return columns (N, G) of the zeros of runs 0 .. G-1."""
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
    """Return the displacements of cases 0 .. K-1 from readings (N,) with noise sigma (N,), each belonging to one case
    (N,).

    rows (N, 6): derivative of a reading by the displacement (``recorded_steps.linear_rows``, ``angular_rows``); shared
    (N, Z): errors common to readings of several cases (``zero_columns``, ``drift_columns``), with known standard
    deviations shared_sigma (Z,), infinite if unknown. Components that the channels of a case do not determine stay
    unknown; other cases contribute nothing. NaN readings are ignored. Raises ValueError for shapes that do not agree,
    and for shared errors that neither readings nor their sigma determine.
    """
    rows, y, shared = np.asarray(rows, float), np.asarray(reading, float), np.asarray(shared, float)
    if rows.shape != (len(y), 6) or len(case) != len(y) or shared.ndim != 2 or len(shared) != len(y):
        raise ValueError(
            f"found rows {rows.shape}, case {case.shape} and shared {shared.shape} of {len(y)} readings: "
            f"expected (N, 6), (N,) and (N, Z)"
        )
    is_observed = np.isfinite(y)
    cases = int(case.max(initial=-1)) + 1
    weight = np.where(is_observed, 1.0 / np.broadcast_to(np.asarray(sigma, float), y.shape), 0.0)
    white, measured, common = rows * weight[:, None], weight * np.where(is_observed, y, 0.0), shared * weight[:, None]
    information, coupling = np.zeros((cases, 6, 6)), np.zeros((cases, 6, shared.shape[1]))
    right = np.zeros((cases, 6))
    np.add.at(information, case, white[:, :, None] * white[:, None, :])
    np.add.at(coupling, case, white[:, :, None] * common[:, None, :])
    np.add.at(right, case, white * measured[:, None])
    inverse, known, rank = _inverse_where_known(information)
    # shared errors are eliminated last: residuals of the cases and prior knowledge determine them
    gain = inverse @ coupling
    prior = np.broadcast_to(np.asarray(shared_sigma, float), shared.shape[1:]) ** -2.0
    shared_information = common.T @ common + np.diag(prior) - np.einsum("kiz,kiy->zy", coupling, gain)
    shared_covariance = _inverse_of_shared(shared_information)
    offset = shared_covariance @ (common.T @ measured - np.einsum("kiz,ki->z", gain, right))
    value = np.einsum("kij,kj->ki", inverse, right) - gain @ offset
    covariance = inverse + gain @ shared_covariance @ np.swapaxes(gain, 1, 2)
    residual = measured - np.einsum("ni,ni->n", white, value[case]) - common @ offset
    both = known[:, :, None] & known[:, None, :]
    covariance = np.where(both, covariance, np.where(np.eye(6, dtype=bool), np.inf, 0.0))
    return PlatformDisplacement(
        np.where(known, value, np.nan),
        covariance,
        known,
        offset,
        shared_covariance,
        np.where(known[..., None], gain, 0.0),
        float(residual @ residual + np.sum(prior * offset**2)),
        int(is_observed.sum() - rank.sum() - np.sum(prior == 0.0)),
    )


def _inverse_of_shared(information: Array) -> Array:
    """Return the inverse (Z, Z) of the information on the shared errors."""
    scale = np.sqrt(np.where(np.diag(information) > 0.0, np.diag(information), 1.0))
    scaled = information / np.outer(scale, scale)
    if len(information) and np.linalg.eigvalsh(scaled)[0] < _RELATIVE:
        raise ValueError(
            "shared errors: found some without effect on any reading, expected a finite shared_sigma for these"
        )
    return np.linalg.inv(scaled) / np.outer(scale, scale)


def _inverse_where_known(information: Array) -> tuple[Array, Mask, Index]:
    """Return pseudo-inverses (K, 6, 6), the mask of determined components (K, 6), and the rank (K,)."""
    size = np.sqrt(np.einsum("kii->ki", information))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(information / (scale[:, :, None] * scale[:, None, :]))
    mask = values > _RELATIVE
    inverse = np.einsum("kie,ke,kje->kij", vectors, mask / np.where(mask, values, 1.0), vectors)
    lost = np.einsum("kie,ke->ki", vectors**2, ~mask)
    known = (lost < _RELATIVE) & (size > 0.0)
    return inverse / (scale[:, :, None] * scale[:, None, :]), known, mask.sum(1)


@dataclass(frozen=True)
class EstimatedMotion:
    """Motions (K, 6), NaN if unknown, with covariance (K, 6, 6), infinite if unknown; correction of readings (K, 6) for
    beam geometry, and its standard deviation, proportional to the load, NaN if unknown."""

    value: Array
    covariance: Array
    added: Array
    added_sigma: Array


class DeclaredBeams(Protocol):
    """Declared geometry of the beams on the platform."""

    def solved(self, load: Array, read: Array, covariance: Array) -> EstimatedMotion:
        """Return the motions of cases under loads (K, 6) from readings of their channels (K, 6), NaN without one."""


@dataclass(frozen=True)
class PlatformPoses:
    """Displacements of K cases, and the zeros and drifts of the runs.

    zero, drift (R, 6) and their sigmas: NaN if a run did not read a channel, or did not determine its drift; drift per
    s. geometry: motions of the cases by the declared beam geometry; None without one.
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


def find_poses(steps: RecordedSteps, beams: DeclaredBeams | None, mask: Mask) -> PlatformPoses:
    """Return displacements from readings, each channel separately: their errors are independent.

    Readings are components of the platform's motion, unless the geometry of their beams is declared. ``mask`` (B, 6):
    readings that a person marked as valid.
    """
    cases = load_cases(steps)
    curves = run_curves(steps.load, steps.time_s, steps.run, steps.reading, steps.sigma)
    curves = replace(curves, rejected=curves.rejected & ~mask)
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
        of_channel, met, drifting = _displacement_of_channel(counted, cases, curves.sigma[rows, k], rows, k)
        value[: len(of_channel.value), k], covariance[: len(of_channel.value), k, k] = (
            of_channel.value[:, k],
            of_channel.covariance[:, k, k],
        )
        sigma = np.sqrt(np.diag(of_channel.shared_covariance))
        terms[0, met, k], terms[1, met, k] = origin[met, k] + of_channel.shared[: len(met)], sigma[: len(met)]
        terms[2, met[drifting], k], terms[3, met[drifting], k] = of_channel.shared[len(met) :], sigma[len(met) :]
    platform_poses = PlatformPoses(steps, cases, curves, value, covariance, *terms)
    if beams is None:
        return platform_poses
    seen = beams.solved(cases.load, value, covariance)
    return replace(platform_poses, value=seen.value, covariance=seen.covariance, geometry=seen)


def _origins(steps: RecordedSteps, curves: RunCurves) -> Array:
    """Return the zeros of runs (R, 6), m and rad: zero, or the unloaded start of runs that begin far from zero, such as
    coordinates."""
    rows = start_rows(steps)
    start = at_starts(np.where(curves.rejected, np.nan, steps.reading), rows)
    return np.where(starts_far_from_zero(start, at_starts(curves.sigma, rows)), start, 0.0)


def _displacement_of_channel(
    steps: RecordedSteps, cases: LoadCases, sigma: Array, rows: Index, k: int
) -> tuple[PlatformDisplacement, Index, Mask]:
    """Return displacements from one channel, its runs, and the mask of runs that determine their own drift by returning
    to a load. The zero of a run is one reading; its drift has no prior."""
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
    displacement = platform_displacement(along, steps.reading[rows, k], sigma, case, shared, known)
    per_second = np.concatenate([np.ones(len(met)), 1.0 / scale])
    return _rescaled(displacement, per_second), met, drifting


def _rescaled(displacement: PlatformDisplacement, factor: Array) -> PlatformDisplacement:
    covariance = displacement.shared_covariance * np.outer(factor, factor)
    return replace(
        displacement, shared=displacement.shared * factor, shared_covariance=covariance, gain=displacement.gain / factor
    )


def _revisits_a_case(case: Index, time: Array) -> bool:
    """True if a run visits a load case at two or more times."""
    visits = np.unique(case, return_inverse=True)[1]
    low, high = np.full(visits.max() + 1, np.inf), np.full(visits.max() + 1, -np.inf)
    np.minimum.at(low, visits, time)
    np.maximum.at(high, visits, time)
    return bool(np.any(high > low))


@dataclass(frozen=True)
class LoadCases:
    """K load cases: case of each of B steps, loads (K, 6), branch (K,) from BRANCHES, mask (K,) of cases excluded from
    fits.

    branch_of_step (B,): branch of each step.
    """

    of_step: Index
    load: Array
    branch: Index
    held_out: Mask
    branch_of_step: Index


def load_cases(steps: RecordedSteps) -> LoadCases:
    """Return the load cases in order of appearance; without load there is only one, on any branch."""
    scale = np.abs(steps.load).max(axis=0, initial=0.0)
    share = np.round(steps.load / np.where(scale > 0.0, scale, 1.0) / _SAME)
    sense = np.zeros(len(share), np.int64)
    for run in range(len(steps.runs)):
        sense[steps.run == run] = branches(share[steps.run == run])
    branch = np.where((share == 0.0).all(axis=1), 1, np.where(sense < 0, 0, 2))
    kind = np.column_stack([share, branch, steps.held_out])
    _, first, number = np.unique(kind, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    index = np.argsort(order)
    first = first[order]
    return LoadCases(index[number.ravel()], steps.load[first], branch[first], steps.held_out[first], branch)
