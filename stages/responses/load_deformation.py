"""Compliance of a loaded platform: its linear and its matrix model from readings, entry by entry beside the simulated
one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.compliance import (
    Comparison,
    Compliance,
    compare,
    left_out_runs,
)
from truing.estimation.interferometry.load_run import BranchGap, gap_of_readings, widest_gap
from truing.estimation.interferometry.loaded import Loaded, fitted_compliance, from_own_zero, r_squared, with_spread
from truing.estimation.interferometry.recorded_steps import ARCSECOND, CHANNELS, LOADS, READING_SI
from truing.estimation.response import ResponseFit, fit_response, residual_sets
from truing.estimation.response_structure import (
    FALSE_ALARM,
    birge,
    entry_tests,
    gain_p_value,
    holm_significant,
    symmetry,
)
from truing.report.numbers import count
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.bench.six_upur.nominal_sensor import SimulatedCompliance
from truing.stages.common.loaded_steps import loaded_steps
from truing.stages.common.nominal_sensor import simulated_compliance
from truing.stages.common.point_arrays import number_column
from truing.stages.common.reading_arrays import LOAD_COLUMNS
from truing.stages.common.rows import Rows
from truing.stages.common.words import gross_errors
from truing.stages.declaration import Outcome
from truing.stages.responses.tables import error_rows

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

Array = NDArray[np.float64]

NO_SIMULATION = "no simulation"
_PARTS = ((slice(0, 3), "um", 1e6), (slice(3, 6), "arcsec", 1.0 / ARCSECOND))
_MEASURED = "measured"
_CURVE_COLUMNS = (*((f"d{axis}_mm", 1e-3) for axis in "xyz"), *((f"r{axis}_rad", 1.0) for axis in "xyz"))


def load_deformation(tables: Mapping[str, pa.Table], settings: Campaign) -> Outcome:
    """Fit the linear and the matrix compliance, one free zero per run, and hold them against the simulated one."""
    simulated = simulated_compliance(settings, tables.get("given_compliance"))
    loaded = loaded_steps(tables, settings.noise, simulated)
    found = {form: with_spread(fitted_compliance(loaded, form), loaded.spread) for form in ("linear", "matrix")}
    against = {} if simulated is None else {form: compare(fit, simulated.entries, simulated.covariance)
                                            for form, fit in found.items()}  # fmt: skip
    artifacts = {
        "compliance": _compliance_rows(found, loaded.spread, simulated, against).table(),
        "deformation_errors": _error_rows(loaded, found, simulated, against).table(),
        "axis_curves": axis_curve_rows(tables["displacement"], simulated).table(),
    }
    read = f"{int(np.isfinite(loaded.reading).sum())} readings of {count(len(loaded.steps.runs), 'run')}"
    return Outcome(artifacts, read, _left_out(tables, loaded), _figure(loaded, found, against))


def _compliance_rows(
    found: Mapping[str, Compliance],
    spread: Array,
    simulated: SimulatedCompliance | None,
    against: Mapping[str, Comparison],
) -> Rows:
    rows = Rows("compliance")
    for name, one in found.items():
        factor = birge(one.fit)
        sigma, p, significant = entry_tests(one.fit)
        i, j = np.nonzero(one.known & (one.fit.free[:, :6]))
        rows.add(
            model=name,
            response=[CHANNELS[k] for k in i],
            load=[LOADS[k] for k in j],
            coefficient=one.entries[i, j],
            sigma=np.hypot(sigma, spread)[i, j],
            unit=[_unit(a, b) for a, b in zip(i, j, strict=True)],
            p_value=p[i, j],
            significant=significant[i, j],
            **_beside(one, factor, i, j, simulated, against.get(name)),
        )
    if simulated is not None:
        i, j = (index.ravel() for index in np.indices((6, 6)))
        rows.add(
            model="simulated",
            response=[CHANNELS[k] for k in i],
            load=[LOADS[k] for k in j],
            coefficient=simulated.entries.ravel(),
            sigma=simulated.sigma.ravel(),
            unit=[_unit(a, b) for a, b in zip(i, j, strict=True)],
        )
    return rows


def _beside(
    one: Compliance,
    factor: float,
    i: NDArray[np.int64],
    j: NDArray[np.int64],
    simulated: SimulatedCompliance | None,
    compared: Comparison | None,
) -> dict[str, object]:
    """The simulated entry, how many sigmas the measured one is off it, and whether that is beyond chance."""
    from scipy.special import ndtr

    if simulated is None or compared is None:
        return {"verdict": [NO_SIMULATION] * len(i)}
    spread = np.hypot(factor * one.sigma[i, j], simulated.sigma[i, j])
    pull = compared.difference[i, j] / spread
    differs = holm_significant(2.0 * ndtr(-np.abs(pull)), FALSE_ALARM)
    return {
        "simulated": simulated.entries[i, j],
        "simulated_sigma": simulated.sigma[i, j],
        "pull": pull,
        "verdict": ["differs" if apart else "agrees" for apart in differs],
    }


def _unit(response: np.int64, load: np.int64) -> str:
    return f"{'m' if response < 3 else 'rad'}/{'N' if load < 3 else '(N m)'}"


def _error_rows(
    loaded: Loaded,
    found: Mapping[str, Compliance],
    simulated: SimulatedCompliance | None,
    against: Mapping[str, Comparison],
) -> Rows:
    rows, fits, held = Rows("deformation_errors"), _fits(loaded, found, simulated), loaded.steps.held_out
    run, load = loaded.steps.run, loaded.steps.load
    for name, fit in fits.items():
        sets = {"": residual_sets(fit)[""]}
        if name in found:
            own = loaded.fitted
            by_others = left_out_runs(load[own], loaded.reading[own], loaded.variance[own], run[own], name)
            sets["cv_"] = by_others if np.isfinite(by_others).all(0).any() else np.full_like(by_others, np.nan)
        entries = _entries(name, found, simulated)
        sets["verification_"] = from_own_zero(loaded.reading[held] - load[held] @ entries.T, run[held])
        for part, unit, scale in _PARTS:
            error_rows(rows, name, fit, sets, unit, scale, CHANNELS, part=part)
        for k, channel in enumerate(CHANNELS):
            share = r_squared(fits["none"], fit, k)
            if np.isfinite(share):
                rows.add(model=name, figure="r_squared", value=share, unit="1", subject=channel)
    gain = gain_p_value(fits["linear"], fits["matrix"])
    rows.add(model="matrix", figure="p_value_over_linear", value=gain, unit="1")
    if found["matrix"].known.all():  # otherwise some of its entries are open, and so is its symmetry
        rows.add(model="matrix", figure="symmetry_p_value", value=symmetry(fits["matrix"]).p_value, unit="1")
    for name, one in against.items():
        rows.add(model=name, figure="agreement_p_value", value=one.p_value, unit="1")
        rows.add(model=name, figure="agreement_chi_square", value=one.chi_square, unit="1")
        rows.add(model=name, figure="entries_compared", value=float(one.dof), unit="1")
    branch_gap_rows(rows, load, run, loaded.reading, np.sqrt(loaded.variance))
    return rows


def _fits(
    loaded: Loaded, found: Mapping[str, Compliance], simulated: SimulatedCompliance | None
) -> dict[str, ResponseFit]:
    """The models from the one without load to the matrix, and what the simulation leaves as it stands."""
    rows = loaded.fitted
    u, y, run = loaded.steps.load[rows], loaded.reading[rows], loaded.steps.run[rows]
    cov = np.where(np.eye(6, dtype=bool), loaded.variance[rows][:, None, :], 0.0)
    fits = {"none": fit_response(u, y, cov, form="none", group=run)}
    if simulated is not None:
        fits["simulated"] = fit_response(u, y - u @ simulated.entries.T, cov, form="none", group=run)
    return fits | {name: one.fit for name, one in found.items()}


def _entries(name: str, found: Mapping[str, Compliance], simulated: SimulatedCompliance | None) -> Array:
    """What a model says of every entry (6, 6); NaN where it says nothing."""
    if name == "simulated":
        assert simulated is not None
        return simulated.entries
    return found[name].entries if name in found else np.zeros((6, 6))


def _left_out(tables: Mapping[str, pa.Table], loaded: Loaded) -> str:
    rows = tables["reading_residuals"].select(["rejected", "decision"]).to_pylist()
    by_person = sum(row["decision"] == "excluded" for row in rows)
    gross = sum(row["rejected"] for row in rows) - by_person
    said = [gross_errors(gross, "reading")] if gross else []
    said += [f"{by_person} reading{'s' * (by_person > 1)} excluded by a person"] if by_person else []
    said += [f"the drift of {loaded.drifts} runs and channels"] if loaded.drifts else []
    return ", ".join(said) or "nothing"


def _figure(loaded: Loaded, found: Mapping[str, Compliance], against: Mapping[str, Comparison]) -> str:
    nothing = fit_response(
        loaded.steps.load[loaded.fitted],
        loaded.reading[loaded.fitted],
        np.where(np.eye(6, dtype=bool), loaded.variance[loaded.fitted][:, None, :], 0.0),
        form="none",
        group=loaded.steps.run[loaded.fitted],
    )
    shares = {name: r_squared(nothing, found["matrix"].fit, k) for k, name in enumerate(CHANNELS)}
    words = ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items() if np.isfinite(share))
    said = f"compliance matrix explains {words}"
    if "matrix" not in against:
        return said
    one = against["matrix"]
    return f"{said}; {one.dof} of 36 entries beside the simulated ones, p {one.p_value:.2g}"


def without_loads() -> dict[str, pa.Table]:
    """The empty tables of a campaign without readings under load."""
    return {name: ARTIFACTS[name].empty() for name in ("compliance", "deformation_errors", "axis_curves")}


def branch_gap_rows(rows: Rows, load: Array, run: NDArray[np.int64], reading: Array, sigma: Array) -> None:
    """Add the widest gap, met loads of all runs taken together, and the probability of such gaps by chance.

    load (B, 6), reading and sigma (B, 6), SI, NaN where there is none. Of runs that load one axis alone.
    """
    loaded = np.stack([np.any(load[run == r] != 0.0, axis=0) for r in range(int(run.max(initial=-1)) + 1)])
    for a, axis in enumerate(LOADS):
        alone = np.flatnonzero(loaded[:, a] & (loaded.sum(1) == 1))
        for k, channel in enumerate(CHANNELS):
            gaps = [gap_of_readings(load[run == r, a], reading[run == r, k], sigma[run == r, k]) for r in alone]
            if met := [gap for gap in gaps if len(gap.load)]:
                _add_branch_gap(rows, f"{channel} under {axis}", k, met)


def _add_branch_gap(rows: Rows, subject: str, k: int, met: list[BranchGap]) -> None:
    gap, chance = widest_gap(met)
    widest = gap / float(READING_SI[k])
    unit = "um" if k < 3 else "arcsec"
    rows.add(model=_MEASURED, figure="branch_gap", value=widest, unit=unit, subject=subject)
    rows.add(model=_MEASURED, figure="branch_gap_p_value", value=chance, unit="1", subject=subject)


def axis_curve_rows(displacement: pa.Table, simulated: SimulatedCompliance | None) -> Rows:
    """Cases whose load is along one axis alone, or none: every component that was measured (force-sensor paper,
    figures 12-17)."""
    load = np.nan_to_num(np.column_stack([number_column(displacement, name) for name in LOAD_COLUMNS]))
    moved = np.column_stack([number_column(displacement, name) * unit for name, unit in _CURVE_COLUMNS])
    sigma = np.sqrt(np.column_stack([number_column(displacement, f"cov_{k}_{k}") for k in range(6)]))
    case = displacement.column("case").to_numpy()
    branch = np.array(displacement.column("branch").to_pylist(), object)
    rows = Rows("axis_curves")
    for a, axis in enumerate(LOADS):
        alone = (np.delete(load, a, axis=1) == 0.0).all(axis=1)
        if not np.any(load[alone, a]):
            continue
        for k, channel in enumerate(CHANNELS):
            at = np.flatnonzero(alone & np.isfinite(moved[:, k]))
            if not np.any(load[at, a]):
                continue
            model = {} if simulated is None else {
                "simulated": simulated.entries[k, a] * load[at, a] / READING_SI[k],
                "simulated_sigma": simulated.sigma[k, a] * np.abs(load[at, a]) / READING_SI[k],
            }  # fmt: skip
            rows.add(
                load=axis,
                channel=channel,
                case=case[at],
                branch=branch[at],
                applied=load[at, a],
                measured=moved[at, k] / READING_SI[k],
                sigma=sigma[at, k] / READING_SI[k],
                unit="um" if k < 3 else "arcsec",
                **model,
            )
    return rows
