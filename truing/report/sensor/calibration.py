"""The section of a sensor's calibration: which one is chosen, G_B, what is left, and theory beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.model_tests import ModelTest, below_noise, listing_of, state_of
from truing.report.numbers import plain, with_uncertainty
from truing.report.page import Listing, Section
from truing.report.sensor.axes import LOADS, load_unit
from truing.report.sensor.calibration_figures import error_classes, held_out_errors, merit_figure
from truing.report.tables import WHY_NOT, Tables, cell, filled, reason

if TYPE_CHECKING:
    import pandas as pd

Drawn = list[tuple[object, str]]
_TITLE = "Calibration of the sensor"
_TYPES = {"type_1_error": "Type 1, with the synthetic error", "type_2_error": "Type 2, without"}
_AT_NOISE = 1.1  # times the noise that an error may be and count as noise
_AS_PRINTED = "least squares, direct, zero none, linear"


def sensor_calibration(tables: Tables) -> Section | None:
    """The choice among calibrations, the matrix, the errors by class, and the figures of merit."""
    if "sensor_matrix" not in tables:
        return None
    matrices = filled(tables, "sensor_matrix")
    if matrices is None:
        return Section("calibration", _TITLE, _why(tables), state="not evaluated")
    choice, classes, merit = (filled(tables, name) for name in ("sensor_choice", "error_classes", "sensor_merit"))
    largest = _largest(tables)
    shown: Drawn = []
    listings: list[Listing] = []
    if choice is not None:
        words = "By fits that have not seen the loads' own case. A term that does not help there is not taken."
        shown.append((held_out_errors(choice, largest), words))
        listings += [_matrix(matrices), _choices(choice, largest)]
    if classes is not None and classes["value"].notna().any():
        words = "Definitions: docs/error-classes.md. Wrenches by the chosen calibration, counted from each run's zero."
        shown.append((error_classes(classes), words))
    if classes is not None:
        listings.append(_classes(classes))
    if merit is not None:
        shown += _merit_drawn(merit)
        listings += [_merits(merit), *_types(merit)]
    lead = _lead(tables, choice, matrices, largest)
    tests = _tests(choice)
    listings.insert(0, listing_of(tests, "Tests of the chosen calibration"))
    return Section("calibration", _TITLE, lead, tuple(shown), tuple(listings), state_of(tests))


def _tests(choice: pd.DataFrame | None) -> list[ModelTest]:
    """Whether the chosen calibration misses what it was not fitted to by no more than noise."""
    held = "held-out loads are missed by what noise leaves"
    verified = "the verification runs are missed by what noise leaves"
    if choice is None:
        return [ModelTest(asked, None, "G_B was not evaluated.") for asked in (held, verified)]
    own = choice[choice["model"] == _chosen(choice)]
    facts = own.drop_duplicates("figure").set_index("figure")["value"]
    return [
        _missed(held, facts, "heldout", "Nothing was held out."),
        _missed(verified, facts, "verification", "No run is for verification, or its noise is not told."),
    ]


def _missed(asked: str, facts: pd.Series, what: str, why_not: str) -> ModelTest:
    chi_square, freedom = facts.get(f"{what}_chi_square"), facts.get(f"{what}_freedom")
    if chi_square is None or freedom is None or not freedom > 0.0:
        return ModelTest(asked, None, why_not)
    if (small := below_noise(asked, float(chi_square), float(freedom), "the noise is declared too large")) is not None:
        return small
    times = float(np.sqrt(chi_square / freedom))
    return ModelTest(asked, times <= _AT_NOISE, f"By {plain(times)} times what noise leaves, rms.")


def _why(tables: Tables) -> str:
    return reason(tables, "sensor_matrix") or "The campaign holds no signals of a sensor."


def _largest(tables: Tables) -> dict[str, float]:
    """The largest load of every axis that was loaded."""
    steps = filled(tables, "signals")
    if steps is None:
        return {}
    columns = zip(LOADS, ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"), strict=True)
    found = {load: float(steps[column].abs().max()) for load, column in columns}
    return {load: size for load, size in found.items() if size > 0.0}


def _lead(tables: Tables, choice: pd.DataFrame | None, matrices: pd.DataFrame, largest: dict[str, float]) -> str:
    if choice is None:
        why = tables["sensor_matrix"].attrs.get(WHY_NOT) or "no signals"
        return f"G by the drawing alone. G_B is not evaluated: {why}."
    chosen = _chosen(choice)
    own = choice[choice["model"] == chosen]
    held = own[own["figure"] == "heldout_rms"].set_index("subject")["value"]
    share = {load: 100.0 * float(held[load]) / largest[load] for load in largest if load in held}
    worst = max(share, key=lambda load: share[load])
    said = [
        f"Chosen: {chosen}. Loads that it was not fitted to it misses by {plain(min(share.values()))} to "
        f"{plain(share[worst])} % of the largest load, rms; {worst} worst, {plain(held[worst])} {load_unit(worst)}."
    ]
    printed = choice[(choice["model"] == _AS_PRINTED) & (choice["figure"] == "heldout_rms")]
    if len(printed) and chosen != printed["model"].iloc[0]:
        other = 100.0 * float(printed.set_index("subject")["value"][worst]) / largest[worst]
        if other > 1.5 * share[worst]:
            said.append(f"Least squares without a zero, as the paper prints it, misses by {plain(other)} % there.")
    said += _verified(own)
    if (own["figure"] == "loads_as_diagnosed").any():
        why = own.loc[own["figure"] == "loads_as_diagnosed", "reason"].iloc[0]
        said.append(f"Loads are taken as the diagnosis has them, with {why}; as written down they make another G_B.")
    equal = choice[(choice["figure"] == "indistinguishable") & (choice["value"] == 1.0)]["model"]
    if len(equal):
        said.append(f"The data cannot tell {' or '.join(equal)} from it; the simpler one is taken.")
    if (own["figure"] == "tared").any() and float(own.loc[own["figure"] == "tared", "value"].iloc[0]):
        said.append(
            "Runs differ in their unloaded signals by more than noise: signals are counted from each run's own."
        )
    return " ".join(said)


def _verified(own: pd.DataFrame) -> list[str]:
    checked = own[own["figure"] == "verification_rms"]
    if not len(checked):
        return []
    named = ", ".join(f"{r.subject} {plain(r.value)} {load_unit(r.subject)}" for r in checked.itertuples())
    return [f"In the verification runs: {named}, rms."]


def _chosen(choice: pd.DataFrame) -> str:
    return str(choice.loc[(choice["figure"] == "chosen") & (choice["value"] == 1.0), "model"].iloc[0])


def _matrix(matrices: pd.DataFrame) -> Listing:
    """G_B of the chosen calibration, each entry with the larger of its two sigmas."""
    own = matrices[(matrices["matrix"] == "G_B") & matrices["chosen"]]
    columns = list(dict.fromkeys(own["column_name"]))
    table = {(r.row, r.column_name): r for r in own.itertuples()}
    rows = []
    for load in LOADS:
        cells = []
        for column in columns:
            one = table[load, column]
            sigma = np.nanmax([one.sigma, getattr(one, "sigma_by_case", np.nan)])
            cells.append(with_uncertainty(one.value, float(sigma)))
        rows.append((f"{load} ({load_unit(load)})", *cells))
    heads = ("load", *(f"per mV of {column}" for column in columns))
    csv = own.drop(columns=["chosen", "matrix"]).to_csv(index=False)
    caption = "G_B of the chosen calibration. ±: the larger of the fit's sigma and that by leaving load cases out"
    return Listing(heads, tuple(rows), (), caption, held_by="sensor_matrix.parquet", csv=csv)


def _choices(choice: pd.DataFrame, largest: dict[str, float]) -> Listing:
    chosen, rows, marks = _chosen(choice), [], []
    for model in dict.fromkeys(choice["model"]):
        own = choice[choice["model"] == model]
        facts = (
            own[own["subject"].isna()].set_index("figure")["value"]
            if "subject" in own
            else own.set_index("figure")["value"]
        )
        if (own["figure"] == "refused").any():
            rows.append((model, *[""] * (len(largest) + 3), cell(own["reason"].iloc[0])))
            marks.append("none")
            continue
        held = own[own["figure"] == "heldout_rms"].set_index("subject")["value"]
        ratio = float(np.sqrt(facts["heldout_chi_square"] / facts["heldout_freedom"]))
        said = "chosen" if model == chosen else "equal" if facts.get("indistinguishable") == 1.0 else ""
        sizes = [plain(float(held[load])) for load in largest]
        rows.append(
            (model, *sizes, plain(ratio), plain(facts.get("heldout_log_density")), plain(facts.get("parameters")), said)
        )
        marks.append("pass" if said == "chosen" else "none" if said else "")
    heads = (
        "model",
        *(f"{load} ({load_unit(load)})" for load in largest),
        "error / expected",
        "log density",
        "numbers",
        "choice",
    )
    caption = "All calibrations by the rms error of held-out loads. Equal: the data cannot tell it from the chosen one"
    return Listing(heads, tuple(rows), tuple(marks), caption, len(rows) > 12, "sensor_choice.parquet")


def _classes(classes: pd.DataFrame) -> Listing:
    rows, marks = [], []
    for r in classes.itertuples():
        if r.value is None or r.value != r.value:
            rows.append((r.load, r.error_class, "", "not evaluated", "", "", cell(getattr(r, "reason", None))))
            marks.append("none")
            continue
        seen = abs(r.value) > r.limit
        at = "" if r.applied != r.applied else f"{plain(r.applied)} {load_unit(r.load)}"
        value = with_uncertainty(r.value, r.sigma)
        rows.append((r.load, r.error_class, r.indicated, value, plain(r.limit), at, "seen" if seen else "within noise"))
        marks.append("warn" if seen else "")
    heads = ("load", "class", "indicated by", "%", "limit of noise, %", "at", "verdict")
    caption = "Error classes of every axis, per cent of the range (interpolation: of the load)"
    return Listing(heads, tuple(rows), tuple(marks), caption, True, "error_classes.parquet")


def _merit_drawn(merit: pd.DataFrame) -> Drawn:
    lengths = merit.loc[merit["matrix"].isin(["G", "G_B'"]), "length_m"].dropna()
    if not len(lengths) or not (merit["figure"] == "sensitivity").any():
        return []
    words = (
        "G: the drawing. G': with assembly errors of one sigma and the largest displacement. G_B': the calibration. "
    )
    words += "Joints that resist carry a part of a load past the legs' cells."
    return [(merit_figure(merit, float(lengths.min())), words)]


def _merits(merit: pd.DataFrame) -> Listing:
    shown = merit[~merit["figure"].isin(["type_1_error", "type_2_error"])]
    rows = tuple(
        (
            r.matrix,
            r.figure.replace("_", " "),
            cell(r.subject),
            with_uncertainty(r.value, r.sigma),
            "" if r.unit == "1" else r.unit,
            "" if r.length_m != r.length_m else f"{plain(r.length_m)} m",
        )
        for r in shown.itertuples()
    )
    heads = ("matrix", "figure", "of", "value", "unit", "moments over")
    return Listing(heads, rows, (), "Figures of merit, raw (1 m) and scaled", True, "sensor_merit.parquet")


def _types(merit: pd.DataFrame) -> list[Listing]:
    types = merit[
        merit["figure"].isin(["type_1_error", "type_2_error"])
        & ~(merit["length_m"] != 1.0).where(merit["length_m"].notna(), False)
    ]
    if not len(types):
        return []
    subjects = [*LOADS, "condition"]
    rows = []
    for (figure, model), own in types.groupby(["figure", "model"], sort=False):
        cells = own.set_index("subject")
        words = f"{_TYPES[figure]}{', joints that resist' if model == 'elastic joints' else ''}"
        rows.append((words, *(with_uncertainty(cells.loc[s, "value"], cells.loc[s, "sigma"]) for s in subjects)))
    heads = ("per cent", *(f"S {load}" for load in LOADS), "condition")
    return [
        Listing(heads, tuple(rows), (), "Theory against calibration, as the paper's Table 5 has it (moments in N·m)")
    ]
