"""The section of a loaded platform's deformation: compliance, measured beside simulated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.report.deformation.figures import compliance_map
from truing.report.model_tests import ModelTest, by_p, listing_of, state_of
from truing.report.numbers import p_equals, p_value, printed, quantity, with_uncertainty
from truing.report.page import Listing, Section
from truing.report.scene.by_leg import by_leg_of_sensor
from truing.report.scene.of_loads import load_scene
from truing.report.scene.view import picture
from truing.report.sensor.axes import CHANNELS, LOADS, per_kilo
from truing.report.sensor.compliance_figure import comparison_map
from truing.report.sensor.curve_figures import differences, own_axes
from truing.report.tables import Tables, cell, filled, reason

if TYPE_CHECKING:
    import pandas as pd

Drawn = list[tuple[object, str]]
_UNCLEAR = 0.01


def load_deformation(tables: Tables) -> Section | None:
    """Curves of load and displacement, the compliance entry by entry, and the models' errors."""
    if "compliance" not in tables:
        return None
    compliance = filled(tables, "compliance")
    if compliance is None:
        why = reason(tables, "compliance") or "The campaign holds no readings of a platform under load."
        return Section("deformation", "Deformation under load", why, state="not evaluated")
    shown = [*_view(tables), *_curves(tables), *_maps(compliance)]
    tests = _tests(tables)
    listings = [listing_of(tests, "Tests of the models"), by_leg_of_sensor(tables), _entries(compliance)]
    listings.append(_errors(tables["deformation_errors"]))
    told = tuple(listing for listing in listings if listing.rows)
    state = state_of(tests)
    return Section("deformation", "Deformation under load", _lead(tables, compliance), tuple(shown), told, state)


def _tests(tables: Tables) -> list[ModelTest]:
    """Whether the measured compliance is the simulated one, and that of something elastic."""
    facts = _facts(tables["deformation_errors"])
    agrees = by_p(
        "the measured compliance is the simulated one",
        facts.get(("matrix", "agreement_p_value")),
        _UNCLEAR,
        (
            "What they differ by, noise and tolerances explain.",
            "They differ by more than these explain.",
        ),
        "There is no simulation to hold it against, or no full matrix was measured.",
    )
    symmetric = by_p(
        "the compliance is symmetric, as an elastic one is",
        facts.get(("matrix", "symmetry_p_value")),
        _UNCLEAR,
        ("What it lacks of symmetry is noise.", "Loads are not what was declared, or the response is not linear."),
        "Not every pair of entries was measured.",
    )
    return [agrees, symmetric]


def _view(tables: Tables) -> Drawn:
    scene = load_scene(tables)
    if scene is None:
        return []
    words = "Upper joints where they are without load (grey) and where the measured displacement puts them (orange). "
    words += "Blue: the load, a torque along the axis that it turns about. Legs that are chosen show their numbers."
    subtitle = f"Each line runs from a joint's place to where the load moves it, at first {scene.gain:g} times as long"
    return [(picture(scene, "Displacement of the platform under load, amplified", subtitle), words)]


def _curves(tables: Tables) -> Drawn:
    curves = filled(tables, "axis_curves")
    if curves is None:
        return []
    own = curves["load"].map(dict(zip(LOADS, CHANNELS, strict=True))) == curves["channel"]
    drawn: Drawn = []
    if own.any():
        drawn.append(
            (own_axes(curves), "Up and back told apart: what lies between them is hysteresis, clearance or creep.")
        )
    if "simulated" in curves and curves["simulated"].notna().any():
        drawn.append(
            (differences(curves), "The same, less the simulation, and what each load does to the other components.")
        )
    return drawn


def _maps(compliance: pd.DataFrame) -> Drawn:
    if not (compliance["model"] == "matrix").any():
        return []
    if (compliance["model"] == "simulated").any():
        words = "Upper number: measured, lower: simulated. Colour: difference over what noise and tolerances let it be."
        return [(comparison_map(compliance), words)]
    return [(compliance_map(compliance), "Row: displacement. Column: load.")]


def _lead(tables: Tables, compliance: pd.DataFrame) -> str:
    facts = _facts(tables["deformation_errors"])
    said = []
    gain = facts.get(("matrix", "p_value_over_linear"))
    if gain is not None and gain == gain:
        verb = "earns" if gain < _UNCLEAR else "does not earn"
        said.append(f"The compliance matrix {verb} its entries over the diagonal alone (p {p_equals(gain)}).")
    measured = compliance[compliance["model"] == "matrix"]
    open_entries = len(CHANNELS) * len(LOADS) - len(measured)
    if open_entries:
        said.append(f"Of 36 entries {open_entries} were never measured: they are unknown, not zero.")
    return " ".join([*said, *_against(measured), *_asymmetry(facts)]) or "Displacement per load."


def _against(measured: pd.DataFrame) -> list[str]:
    """Which entries the simulation gets wrong, the worst first."""
    if "pull" not in measured or not measured["pull"].notna().any():
        return ["There is no simulation to hold it against."]
    apart = measured[measured["verdict"] == "differs"]
    if not len(apart):
        agree = "The one measured entry agrees" if len(measured) == 1 else f"All {len(measured)} measured entries agree"
        return [f"{agree} with the simulated ones within noise and tolerances."]
    worst = apart.reindex(apart["pull"].abs().sort_values(ascending=False).index)
    named = ", ".join(f"{r.response} under {r.load} ({r.pull:+.1f} sigma)" for r in worst.head(6).itertuples())
    more = f" and {len(worst) - 6} more" if len(worst) > 6 else ""
    return [f"{len(apart)} of {len(measured)} measured entries differ from the simulated ones: {named}{more}."]


def _asymmetry(facts: dict[tuple[str, str], float]) -> list[str]:
    p = facts.get(("matrix", "symmetry_p_value"))
    if p is None or p >= _UNCLEAR:
        return []
    return [
        f"The matrix is not symmetric (p {p_equals(p)}), as an elastic one is: loads are not what was declared, "
        "or the response is not linear."
    ]


def _facts(errors: pd.DataFrame) -> dict[tuple[str, str], float]:
    return {(r.model, r.figure): float(r.value) for r in errors.itertuples() if r.value is not None}


def _entries(compliance: pd.DataFrame) -> Listing:
    """Every entry of the matrix: measured and simulated, and those that were never measured."""
    table = {(r.response, r.load): r for r in compliance[compliance["model"] == "matrix"].itertuples()}
    drawing = {(r.response, r.load): r for r in compliance[compliance["model"] == "simulated"].itertuples()}
    rows, marks = [], []
    for response in CHANNELS:
        for load in LOADS:
            one, two = table.get((response, load)), drawing.get((response, load))
            factor, unit = per_kilo(response, load)
            measured = "not measured" if one is None else with_uncertainty(factor * one.coefficient, factor * one.sigma)
            simulated = "–" if two is None else with_uncertainty(factor * two.coefficient, factor * two.sigma)
            pull = "" if one is None else _pull(getattr(one, "pull", None))
            verdict = "" if one is None else cell(getattr(one, "verdict", None))
            rows.append((response, load, measured, simulated, unit, pull, verdict))
            marks.append({"differs": "warn", "agrees": "pass"}.get(verdict, "none"))
    heads = ("component", "load", "measured", "simulated", "unit", "sigmas apart", "verdict")
    caption = "Compliance, entry by entry. Differs: at 5 % false alarms over all entries together"
    return Listing(heads, tuple(rows), tuple(marks), caption, True, "compliance.parquet")


def _pull(pull: float | None) -> str:
    return "" if pull is None or pull != pull else f"{pull:+.1f}"


def _errors(errors: pd.DataFrame) -> Listing:
    rows = tuple(
        (
            r.model,
            cell(getattr(r, "subject", None)) or "all",
            printed(r.figure.replace("_", " ")),
            p_value(r.value) if "p_value" in r.figure else quantity(r.value, r.unit),
        )
        for r in errors.itertuples()
    )
    heads = ("model", "component", "figure", "value")
    caption = "Error figures of every model; cv: whole runs left out; verification: runs that nothing was fitted to"
    return Listing(heads, rows, (), caption, True, "deformation_errors.parquet")
