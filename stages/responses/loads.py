"""Compliance of a loaded platform, measured and simulated, and positioning of an axis by ISO 230-2."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Index
from truing.estimation.interferometry.compliance import (
    Compliance,
    ComplianceComparison,
    Loaded,
    compare,
    fitted_compliance,
    from_own_zero,
    left_out_runs,
    r_squared,
    reference_fits,
    with_spread,
)
from truing.estimation.interferometry.iso230 import Positioning, positioning, positioning_uncertainty
from truing.estimation.interferometry.load_run import widest_gaps
from truing.estimation.interferometry.recorded_steps import ARCSECOND, CHANNELS, LOADS, READING_SI, READING_UNITS
from truing.estimation.response import (
    FALSE_ALARM,
    ResponseFit,
    birge,
    entry_tests,
    gain_p_value,
    holm_significant,
    residual_sets,
    symmetry,
)
from truing.report.numbers import count_text, gross_errors, p_value
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults
from truing.simulation.bench.six_upur.nominal_sensor import SimulatedCompliance
from truing.stages.common.belonging import subject_of, withheld_runs
from truing.stages.common.loaded_steps import loaded_steps
from truing.stages.common.missing_data import why_no_deformation_of_loads
from truing.stages.common.nominal_sensor import simulated_compliance
from truing.stages.common.point_arrays import number_columns
from truing.stages.common.positioning import SEED, deviations, instrument
from truing.stages.common.reading_arrays import LOAD_COLUMNS, MOVED_COLUMNS, MOVED_SI
from truing.stages.common.rows import Rows
from truing.stages.declaration import Outcome
from truing.stages.responses.neglected import neglected_effects
from truing.stages.responses.published import compared_with_published
from truing.stages.responses.tables import ReportedResponses, add_figures, error_rows
from truing.stages.responses.tolerances import has_tolerances, tolerance_tables

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.interferometer import Interferometer

LEAVES = ("compliance", "deformation_errors", "axis_curves")
NO_SIMULATION = "no simulation"
_PARTS = (
    ReportedResponses("um", 1e6, CHANNELS, slice(0, 3)),
    ReportedResponses("arcsec", 1.0 / ARCSECOND, CHANNELS, slice(3, 6)),
)
_MEASURED = "measured"
_UM = 1e3  # per mm
_DIRECTIONS = ("forward", "backward")


def load_deformation(tables: Mapping[str, pa.Table], settings: Campaign, why: str = "") -> Outcome:
    """Fit the linear and the matrix compliance, with one zero per run, and compare them with the simulated one.

    ``why``: reason to withhold results; empty if there is none.
    """
    if why := why or why_no_deformation_of_loads(tables.get("readings")):
        return Outcome.not_evaluated({name: ARTIFACTS[name].empty() for name in LEAVES}, why)
    simulated = simulated_compliance(settings, tables.get("given_compliance"))
    loaded = loaded_steps(tables, settings.noise, simulated)
    compliances = {form: with_spread(fitted_compliance(loaded, form), loaded.spread) for form in ("linear", "matrix")}
    against = {} if simulated is None else {form: compare(fit, simulated.entries, simulated.covariance)
                                            for form, fit in compliances.items()}  # fmt: skip
    fits = reference_fits(loaded, None if simulated is None else simulated.entries)
    fits |= {form: one.fit for form, one in compliances.items()}
    compliance = _compliance_rows(compliances, loaded.spread, simulated, against).table()
    artifacts = {
        "compliance": compliance,
        "deformation_errors": _error_rows(loaded, fits, compliances, simulated, against).table(),
        "axis_curves": axis_curve_rows(tables["displacement"], simulated).table(),
    }
    artifacts |= neglected_effects(settings, simulated, compliance)
    if "published" in tables:
        artifacts["published_compared"] = compared_with_published(
            tables["published"], artifacts["axis_curves"], simulated
        ).table()
    read = f"{int(np.isfinite(loaded.reading).sum())} readings of {count_text(len(loaded.steps.runs), 'run')}"
    return Outcome(artifacts, read, _left_out(tables, loaded), _figure(fits, against, compliance))


def _compliance_rows(
    compliances: Mapping[str, Compliance],
    spread: Array,
    simulated: SimulatedCompliance | None,
    against: Mapping[str, ComplianceComparison],
) -> Rows:
    rows = Rows("compliance")
    for name, compliance in compliances.items():
        factor = birge(compliance.fit)
        sigma, p, significant = entry_tests(compliance.fit)
        i, j = np.nonzero(compliance.known & (compliance.fit.free[:, :6]))
        rows.add(
            model=name,
            response=[CHANNELS[k] for k in i],
            load=[LOADS[k] for k in j],
            coefficient=compliance.entries[i, j],
            sigma=np.hypot(sigma, spread)[i, j],
            unit=[_unit(a, b) for a, b in zip(i, j, strict=True)],
            p_value=p[i, j],
            significant=significant[i, j],
            **_compared_with_simulation(compliance, factor, i, j, simulated, against.get(name)),
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


def _compared_with_simulation(
    compliance: Compliance,
    factor: float,
    i: Index,
    j: Index,
    simulated: SimulatedCompliance | None,
    compared: ComplianceComparison | None,
) -> dict[str, object]:
    """Return the simulated entry, the deviation of the measured one in sigmas, and whether it is significant."""
    from scipy.special import ndtr

    if simulated is None or compared is None:
        return {"verdict": [NO_SIMULATION] * len(i)}
    spread = np.hypot(factor * compliance.sigma[i, j], simulated.sigma[i, j])
    pull = compared.difference[i, j] / spread
    differs = holm_significant(2.0 * ndtr(-np.abs(pull)), FALSE_ALARM)
    return {
        "simulated": simulated.entries[i, j],
        "simulated_sigma": simulated.sigma[i, j],
        "pull": pull,
        "verdict": ["differs" if is_other else "agrees" for is_other in differs],
    }


def _unit(response: np.int64, load: np.int64) -> str:
    return f"{'m' if response < 3 else 'rad'}/{'N' if load < 3 else '(N m)'}"


def _error_rows(
    loaded: Loaded,
    fits: Mapping[str, ResponseFit],
    compliances: Mapping[str, Compliance],
    simulated: SimulatedCompliance | None,
    against: Mapping[str, ComplianceComparison],
) -> Rows:
    rows, is_held_out = Rows("deformation_errors"), loaded.steps.held_out
    run, load = loaded.steps.run, loaded.steps.load
    for name, fit in fits.items():
        sets = {"": residual_sets(fit)[""]}
        if name in compliances:
            used = loaded.fitted
            by_others = left_out_runs(load[used], loaded.reading[used], loaded.variance[used], run[used], name)
            sets["cv_"] = by_others if np.isfinite(by_others).all(0).any() else np.full_like(by_others, np.nan)
        entries = _entries(name, compliances, simulated)
        sets["verification_"] = from_own_zero(
            loaded.reading[is_held_out] - load[is_held_out] @ entries.T, run[is_held_out]
        )
        for part in _PARTS:
            error_rows(rows, name, fit, sets, part)
        for k, channel in enumerate(CHANNELS):
            if np.isfinite(share := r_squared(fits["none"], fit, k)):
                add_figures(rows, name, {"r_squared": share}, channel)
    gain = gain_p_value(fits["linear"], fits["matrix"])
    add_figures(rows, "matrix", {"p_value_over_linear": gain})
    if compliances["matrix"].known.all():  # otherwise some of its entries are open, and so is its symmetry
        add_figures(rows, "matrix", {"symmetry_p_value": symmetry(fits["matrix"]).p_value})
    for name, comparison in against.items():
        agreement = {"agreement_p_value": comparison.p_value, "agreement_chi_square": comparison.chi_square}
        add_figures(rows, name, {**agreement, "entries_compared": comparison.dof})
    for (axis, k), (gap, chance) in widest_gaps(load, run, loaded.reading, np.sqrt(loaded.variance)).items():
        subject = f"{CHANNELS[k]} under {LOADS[axis]}"
        widest, unit = gap / float(READING_SI[k]), READING_UNITS[k]
        rows.add(model=_MEASURED, figure="branch_gap", value=widest, unit=unit, subject=subject)
        add_figures(rows, _MEASURED, {"branch_gap_p_value": chance}, subject)
    return rows


def _entries(name: str, compliances: Mapping[str, Compliance], simulated: SimulatedCompliance | None) -> Array:
    """Return the compliance entries (6, 6) of a model; zero for entries that it does not contain."""
    if name == "simulated":
        assert simulated is not None
        return simulated.entries
    return compliances[name].entries if name in compliances else np.zeros((6, 6))


def _left_out(tables: Mapping[str, pa.Table], loaded: Loaded) -> str:
    rows = tables["reading_residuals"].select(["rejected", "decision"]).to_pylist()
    by_person = sum(row["decision"] == "excluded" for row in rows)
    gross = sum(row["rejected"] for row in rows) - by_person
    texts = [gross_errors(gross, "reading")] if gross else []
    texts += [f"{by_person} reading{'s' * (by_person > 1)} excluded by a person"] if by_person else []
    texts += [f"the drift of {loaded.drifts} runs and channels"] if loaded.drifts else []
    return ", ".join(texts) or "nothing"


def _figure(fits: Mapping[str, ResponseFit], against: Mapping[str, ComplianceComparison], compliance: pa.Table) -> str:
    shares = {name: r_squared(fits["none"], fits["matrix"], k) for k, name in enumerate(CHANNELS)}
    words = ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items() if np.isfinite(share))
    text = f"compliance matrix explains {words} of the variance"
    if "matrix" not in against:
        return text
    verdicts = [row["verdict"] for row in compliance.to_pylist() if row["model"] == "matrix"]
    missed, p = verdicts.count("differs"), p_value(against["matrix"].p_value)
    return f"{text}; simulation misses {missed} of {count_text(len(verdicts), 'measured entry')} (p {p})"


def axis_curve_rows(displacement: pa.Table, simulated: SimulatedCompliance | None) -> Rows:
    """Add load cases along one axis alone, or without load, with all measured components (force-sensor paper, figures
    12-17)."""
    load = np.nan_to_num(number_columns(displacement, LOAD_COLUMNS))
    moved = number_columns(displacement, MOVED_COLUMNS) * MOVED_SI
    sigma = np.sqrt(number_columns(displacement, [f"cov_{k}_{k}" for k in range(6)]))
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
                unit=READING_UNITS[k],
                **model,
            )
    return rows


def with_positioning(outcome: Outcome, tables: Mapping[str, pa.Table], settings: Campaign) -> Outcome:
    """Return the outcome of the loads with the positioning results of an axis, without runs that failed a check."""
    if "positions" not in tables or not tables["positions"].num_rows:
        return outcome
    positions, withheld = tables["positions"], withheld_runs(tables)
    rows = positioning_rows(positions, settings.interferometer, withheld).table(str(positions.schema.field("run").type))
    read, text = f"{count_text(positions.num_rows, 'approach')} of an axis", positioning_words(rows, withheld)
    return replace(
        outcome,
        artifacts={**outcome.artifacts, "positioning": rows},
        read=read if outcome.read == "nothing" else f"{outcome.read}; {read}",
        figure=text if outcome.read == "nothing" else f"{outcome.figure}; {text}",
    )


def with_tolerances(outcome: Outcome, settings: Campaign) -> Outcome:
    """Results of the loads, and the errors of the sensor as designed by its tolerances, which no data change.

    A sensor whose legs do not hold the platform, or do not close, has none; `truing design --tolerances` says why.
    """
    if not has_tolerances(settings):
        return outcome
    try:
        return replace(outcome, artifacts={**outcome.artifacts, **tolerance_tables(settings)})
    except CampaignFaults:
        return outcome


def positioning_rows(positions: pa.Table, optics: Interferometer, withheld: Collection[str] = ()) -> Rows:
    """Return all quantities of all runs, um; those of the axis with their uncertainty if known.

    ``withheld``: subjects (as in qa.parquet) of runs whose results are withheld.
    """
    rows = Rows("positioning")
    names = positions.column("run").to_pylist()
    runs = np.array([str(name) for name in names], dtype=object)
    for run in dict.fromkeys(names):
        if subject_of(run) in withheld:
            continue
        rows_of_run = positions.filter((runs == str(run)).tolist())
        target, deviation = deviations(rows_of_run)
        figures = positioning(deviation)
        _add_target_figures(rows, run, target, figures)
        _add_axis_figures(rows, run, figures)
        known = positioning_uncertainty(
            deviation, target * _UM, np.random.default_rng(SEED), instrument(rows_of_run, optics)
        )
        for figure, figure_value in known.items():
            _add_position(
                rows,
                run,
                figure,
                None,
                figure_value.value,
                sigma=figure_value.sigma,
                low=figure_value.low,
                high=figure_value.high,
            )
    return rows


def positioning_words(rows: pa.Table, withheld: Mapping[str, str]) -> str:
    """Return the accuracy of each run in words, or the reason why it is not evaluated."""
    sentences = [
        f"{row['run']}: A {row['value']:.3g} um, B {_value(rows, row['run'], 'B'):.3g} um"
        for row in rows.to_pylist()
        if row["figure"] == "A" and row["subject"] is None
    ]
    sentences += [f"not evaluated: {why}" for why in withheld.values()]
    return f"positioning by ISO 230-2: {'; '.join(sentences)}"


def _value(rows: pa.Table, run: int | str, figure: str) -> float:
    return float(
        next(
            row["value"]
            for row in rows.to_pylist()
            if (row["run"], row["figure"], row["subject"]) == (run, figure, None)
        )
    )


def _add_target_figures(rows: Rows, run: int | str, target: Array, figures: Positioning) -> None:
    for index, at in enumerate(target):
        subject = f"{at:g} mm"
        for direction, name in enumerate(_DIRECTIONS):
            _add_position(rows, run, f"mean_{name}", subject, figures.mean[index, direction])
            _add_position(rows, run, f"s_{name}", subject, figures.scatter[index, direction])
            _add_position(rows, run, f"R_{name}", subject, figures.repeatability_at[index, direction])
        _add_position(rows, run, "B", subject, figures.reversal_at[index])
        _add_position(rows, run, "R", subject, figures.bidirectional_at[index])


def _add_axis_figures(rows: Rows, run: int | str, figures: Positioning) -> None:
    _add_position(rows, run, "B_mean", None, float(figures.mean_reversal))
    for direction, name in enumerate(_DIRECTIONS):
        _add_position(rows, run, f"R_{name}", None, figures.repeatability[direction])
        _add_position(rows, run, f"E_{name}", None, figures.systematic[direction])
        _add_position(rows, run, f"A_{name}", None, figures.accuracy[direction])


def _add_position(rows: Rows, run: int | str, figure: str, subject: str | None, value: float, **more: float) -> None:
    rows.add(run=run, figure=figure, subject=subject, value=float(value), unit="um", **more)
