"""The sections of a run's page, each from the tables it shows; a section without its table says so."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report import figures
from truing.report.numbers import p_value, plain, with_uncertainty
from truing.report.page import Head, Listing, Section

if TYPE_CHECKING:
    import pandas as pd

Tables = Mapping[str, "pd.DataFrame"]

_MODEL_WORDS = {
    "none": "rms shift, no model",
    "linear": "rms left, linear model",
    "matrix": "rms left, matrix model",
}
_VERDICT_ORDER = {"fail": 0, "warn": 1, "pass": 2, "not evaluated": 3}


def build_sections(tables: Tables, provenance: Mapping[str, Mapping[str, str]]) -> list[Section]:
    """Every section that this kind of campaign has, in the order in which it is read."""
    return [
        section
        for section in (
            measured(tables),
            quality(tables),
            diagnosis(tables),
            poses(tables),
            deformation(tables),
            excluded(tables),
            provenance_section(provenance),
        )
        if section is not None
    ]


def build_head(campaign: str, tables: Tables) -> Head:
    """The sentences that a busy person acts on, and the figures that place them."""
    verdicts = [*_diagnosis_sentences(tables), _quality_sentence(tables)]
    return Head(campaign, tuple(v for v in verdicts if v is not None), tuple(_tiles(tables)))


def _diagnosis_sentences(tables: Tables) -> list[tuple[str, str]]:
    found = tables["diagnosis"][tables["diagnosis"]["verdict"] == "found"] if "diagnosis" in tables else None
    if found is None:
        return []
    if not len(found):
        return [
            ("pass", "No cause of the catalogue was found: the simulation agrees with the data to within its noise.")
        ]
    return [("found", str(text)) for text in found.sort_values("rank")["explanation"]]


def _quality_sentence(tables: Tables) -> tuple[str, str] | None:
    if "qa" not in tables:
        return None
    qa = tables["qa"]
    open_rows = qa[qa["accepted"].isna()] if "accepted" in qa else qa
    failed, warned = (open_rows[open_rows["verdict"] == v] for v in ("fail", "warn"))
    if len(failed):
        return ("fail", f"{_count(len(failed), 'quality check')} failed: " + " ".join(failed["message"][:3]))
    if len(warned):
        return (
            "warn",
            f"No quality check failed; {len(warned)} of {len(qa)} call for a look. {warned['message'].iloc[0]}",
        )
    return ("pass", f"All {len(qa)} quality checks are in order.")


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


def _tiles(tables: Tables) -> list[tuple[str, str]]:
    tiles = []
    if "observations" in tables:
        points = tables["observations"]
        tiles += [("poses", str(points["pose"].nunique())), ("object points", str(len(points)))]
    if "displacement" in tables:
        tiles += [("load steps", str(len(tables["displacement"])))]
    if "residuals" in tables and len(tables["residuals"]):
        tiles += [("gross errors", f"{100 * tables['residuals']['rejected'].mean():.1f} %")]
    errors = tables.get("deformation_errors")
    if errors is not None and len(errors):
        whole = errors[errors["figure"].eq("rms_error") & errors["leg"].isna() & errors["subject"].isna()]
        tiles += [
            (_MODEL_WORDS.get(row.model, row.model), f"{plain(row.value)} {_nice(row.unit)}")
            for row in whole.itertuples()
        ][:3]
    return tiles


def measured(tables: Tables) -> Section | None:
    """What was measured: bodies, targets, poses by role, time and temperature."""
    if "observations" not in tables:
        return _measured_loads(tables)
    points = tables["observations"]
    rows = [
        (str(body), str(part["target"].nunique()), str(part["pose"].nunique()), str(len(part)), _sigmas(part))
        for body, part in points.groupby("body", sort=False)
    ]
    heads = ("body", "targets", "poses", "points", "median sigma x, y, z (µm)")
    listing = Listing(heads, tuple(rows), caption="Bodies and their targets")
    return Section("measured", "Measured", _campaign_sentence(tables), listings=(listing,))


def _measured_loads(tables: Tables) -> Section | None:
    if "displacement" not in tables:
        return None
    steps = tables["displacement"]
    lead = f"{len(steps)} load steps in {_count(steps['run'].nunique(), 'run')}, six components of displacement each."
    loads = [c for c in ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm") if c in steps]
    rows = tuple((c, plain(steps[c].min()), plain(steps[c].max())) for c in loads)
    return Section("measured", "Measured", lead, listings=(Listing(("load", "from", "to"), rows),))


def _sigmas(part: pd.DataFrame) -> str:
    medians = part[["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]].median() * 1e3
    return ", ".join(plain(m) for m in medians)


def _campaign_sentence(tables: Tables) -> str:
    if "configurations" not in tables or not len(tables["configurations"]):
        return "No table of configurations: poses stand in the order in which they came."
    conf = tables["configurations"]
    roles = ", ".join(f"{n} {role}" for role, n in conf["role"].value_counts().items())
    hours = float(np.ptp(conf["time_s"])) / 3600.0
    sentence = f"{len(conf)} configurations ({roles}) over {hours:.1f} h"
    if "temperature_c" in conf and conf["temperature_c"].notna().any():
        low, high = conf["temperature_c"].min(), conf["temperature_c"].max()
        sentence += f", at {low:.2f} to {high:.2f} °C"
    return sentence + "."


def quality(tables: Tables) -> Section | None:
    """Every check with its verdict, the failed ones first."""
    if "qa" not in tables:
        return None
    qa = tables["qa"].assign(order=tables["qa"]["verdict"].map(_VERDICT_ORDER)).sort_values("order", kind="stable")
    accepted = qa["accepted"] if "accepted" in qa else qa["verdict"].map(lambda _: None)
    rows = [
        (
            r.verdict,
            r.check,
            _text(r.subject),
            f"{plain(r.value)} {_text(r.unit)}".strip(),
            plain(r.limit),
            r.message,
            _text(a),
        )
        for r, a in zip(qa.itertuples(), accepted, strict=True)
    ]
    heads = ("verdict", "check", "subject", "value", "limit", "what it says", "accepted by")
    marks = tuple(qa["verdict"])
    alarm = [i for i, mark in enumerate(marks) if mark in ("fail", "warn")]
    listings = [Listing(heads, tuple(rows[i] for i in alarm), tuple(marks[i] for i in alarm))] if alarm else []
    listings.append(Listing(heads, tuple(rows), marks, caption=f"All {len(rows)} checks", folded=True))
    counts = ", ".join(f"{n} {v}" for v, n in qa["verdict"].value_counts().items())
    return Section("qa", "Quality", f"Verdicts: {counts}.", listings=tuple(listings))


def _nice(unit: str) -> str:
    return unit.replace("um", "µm").replace("urad", "µrad")


def _text(value: object) -> str:
    return "" if value is None or value != value else str(value)


def diagnosis(tables: Tables) -> Section | None:
    """What the simulation gets wrong: candidates with their evidence and their gain."""
    if "diagnosis" not in tables:
        return None
    table = tables["diagnosis"].sort_values("rank")
    if not len(table):
        return Section("diagnosis", "Diagnosis", "No candidate cause was judged.", state="not evaluated")
    rows = tuple(
        (
            str(r.rank),
            r.cause,
            r.verdict,
            _text(r.subject),
            p_value(r.p_value),
            plain(r.probability),
            f"{plain(r.rms_before)} → {plain(r.rms_after)}",
            f"{plain(r.heldout_rms_before)} → {plain(r.heldout_rms_after)}",
            plain(r.noise_floor),
            _text(r.unit),
        )
        for r in table.itertuples()
    )
    heads = ("rank", "cause", "verdict", "subject", "p", "probability", "rms", "held-out rms", "noise floor", "unit")
    listings = [Listing(heads, rows, caption="Candidate causes, before and after each is accepted")]
    found = table[table["verdict"] == "found"]
    listings += [_parameter_listing(r.cause, r.parameters) for r in found.itertuples()]
    words = " ".join(str(e) for e in (found if len(found) else table.head(1))["explanation"])
    then = " ".join(_text(n) for n in found["next_measurement"])
    return Section("diagnosis", "Diagnosis", f"{words} {then}".strip(), listings=tuple(listings))


def _parameter_listing(cause: str, parameters: str) -> Listing:
    rows = tuple(
        (
            name,
            with_uncertainty(p["value"], p.get("sigma")) if isinstance(p["value"], (int, float)) else str(p["value"]),
            _text(p.get("unit")),
        )
        for name, p in json.loads(parameters).items()
    )
    return Listing(("parameter", "value", "unit"), rows, caption=f"Parameters of {cause}", folded=len(rows) > 8)


def poses(tables: Tables) -> Section | None:
    """Poses of every body with their uncertainty."""
    if "poses" not in tables:
        return None
    table = tables["poses"]
    chosen = table[table["default"]]
    good = chosen[chosen["status"] == "ok"]
    lost = len(chosen) - len(good)
    lead = f"{len(good)} poses of {good['body'].nunique()} bodies by {', '.join(good['method'].unique())}"
    lead += f"; {lost} could not be determined." if lost else "."
    shown = (
        (
            (
                figures.pose_residuals(good),
                "A pose that stands out here deserves a look at its photographs or its log.",
            ),
            (
                figures.pose_uncertainty(good),
                "All known noise is propagated: points, survey, and the body that a pose is seen from.",
            ),
        )
        if len(good)
        else ()
    )
    rows = tuple(_pose_row(r) for r in chosen.itertuples())
    heads = ("pose", "body", "from", "x, y, z (mm)", "rotation vector (mrad)", "rms (µm)", "used", "rejected", "status")
    listing = Listing(heads, rows, caption=f"All {len(rows)} poses", folded=True)
    return Section("poses", "Poses", lead, shown, (listing,))


def _pose_row(r: Any) -> tuple[str, ...]:
    def many(names: str, first: int, factor: float) -> str:
        cells = []
        for k, name in enumerate(names.split()):
            variance = getattr(r, f"cov_{first + k}_{first + k}")
            cells.append(
                with_uncertainty(factor * getattr(r, name), 1e3 * variance**0.5 if variance == variance else None)
            )
        return ", ".join(cells)

    return (
        str(r.pose),
        r.body,
        r.parent,
        many("px_mm py_mm pz_mm", 0, 1.0),
        many("rx_rad ry_rad rz_rad", 3, 1e3),
        plain(1e3 * r.rms_mm),
        str(r.n_used),
        str(r.n_rejected),
        r.status,
    )


def deformation(tables: Tables) -> Section | None:
    """The deformation picture, the shifts against their drives, and the models."""
    if "deformation_errors" not in tables:
        return None
    if not len(tables["deformation_errors"]):
        return Section(
            "deformation", "Deformation", "The campaign does not hold what this needs.", state="not evaluated"
        )
    shown = [*_picture(tables), *_legs(tables), *_targets(tables), *_loads(tables)]
    return Section("deformation", "Deformation", _deformation_sentence(tables), tuple(shown), (_error_listing(tables),))


def _picture(tables: Tables) -> list[tuple[object, str]]:
    if "survey" not in tables or "residuals" not in tables:
        return []
    survey, residuals = tables["survey"], tables["residuals"]
    body = "platform" if "platform" in set(survey["body"]) else str(residuals["body"].iloc[0])
    part = _without_gross_attachments(residuals[residuals["body"] == body], survey, tables.get("deformation"))
    if not len(part):
        return []
    has_legs = survey["leg"].notna().any()
    words = f"Targets of {body} and how far each is from its place in the survey, in the poses that deform most."
    words += " Orange: targets at the attachments; the dotted ring joins them as displaced." if has_legs else ""
    return [(figures.deformation_picture(survey, part, bool(has_legs)), words)]


def _without_gross_attachments(
    residuals: pd.DataFrame, survey: pd.DataFrame, shifts: pd.DataFrame | None
) -> pd.DataFrame:
    """Residuals less the attachments that were left out of the deformation models as gross errors."""
    if shifts is None or not len(shifts) or "rejected" not in shifts:
        return residuals
    gross = shifts.loc[shifts["rejected"], ["pose", "leg"]].assign(gross=True)
    legs = residuals.merge(survey[["body", "target", "leg"]], on=["body", "target"], how="left")
    marked = legs.merge(gross, on=["pose", "leg"], how="left")["gross"].notna().to_numpy()
    return residuals[~marked]


def _legs(tables: Tables) -> list[tuple[object, str]]:
    shifts = tables.get("deformation")
    if shifts is None or not len(shifts):
        return []
    models = tables["deformation_models"]
    drawn = [
        (
            figures.shift_against_drive(shifts, models),
            "Points off the line: what the other actuators do, or noise. Red crosses were left out as gross errors.",
        )
    ]
    if (models["model"] == "matrix").any():
        drawn.append((figures.coefficient_map(models), "Row: attachment that shifts. Column: actuator that moves it."))
    return drawn


def _targets(tables: Tables) -> list[tuple[object, str]]:
    shifts = tables.get("target_deformation")
    if shifts is None or not len(shifts) or "configurations" not in tables:
        return []
    models = tables["deformation_models"]
    drawn = []
    for drive in models["drive"].dropna().unique() if "drive" in models else ():
        top = (
            models[models["drive"] == drive].assign(z=lambda t: (t["coefficient"] / t["sigma"]).abs()).nlargest(6, "z")
        )
        chosen = shifts.merge(top[["body", "target", "axis"]], on=["body", "target", "axis"])
        values = tables["configurations"].set_index("pose")[drive]
        drawn.append(
            (figures.target_against_drive(chosen, values, drive), "The six coordinates that follow it most clearly.")
        )
    return drawn


def _loads(tables: Tables) -> list[tuple[object, str]]:
    if "compliance" not in tables or not len(tables["compliance"]):
        return []
    return [(figures.compliance_map(tables["compliance"]), "Row: displacement. Column: load.")]


def _deformation_sentence(tables: Tables) -> str:
    facts = tables["deformation_errors"].set_index(["model", "figure"])["value"]
    words = []
    if ("matrix", "p_value_over_linear") in facts:
        p = float(facts[("matrix", "p_value_over_linear")])
        verb = "earns" if p < 0.01 else "does not earn"
        words.append(f"The matrix model {verb} its parameters over the linear one (p {p_value(p)}).")
    if ("matrix", "rank") in facts:
        words.append(f"K has {int(facts[('matrix', 'rank')])} independent shapes above noise.")
    if ("none", "share_buckle") in facts:
        lift, tilt, buckle = (100 * float(facts[("none", f"share_{s}")]) for s in ("lift", "tilt", "buckle"))
        words.append(
            f"Of the mean square shift {lift:.0f} % is lift, {tilt:.0f} % tilt and {buckle:.0f} % buckling of the ring."
        )
    if ("matrix", "modulo_plane") in facts and float(facts[("matrix", "modulo_plane")]):
        words.append("Known modulo a plane only: the platform has fewer than three targets away from its attachments.")
    return " ".join(words) or "Coefficients and errors of the deformation models."


def _error_listing(tables: Tables) -> Listing:
    errors = tables["deformation_errors"]
    rows = tuple(
        (
            r.model,
            "all" if r.leg != r.leg else f"leg {int(r.leg)}",
            _text(getattr(r, "subject", None)),
            r.figure,
            f"{plain(r.value)} {'' if r.unit == '1' else r.unit}".strip(),
        )
        for r in errors.itertuples()
    )
    heads = ("model", "of", "subject", "figure", "value")
    return Listing(heads, rows, caption="Error figures of every model", folded=True)


def excluded(tables: Tables) -> Section:
    """What was left out, by which rule or person, and why."""
    listings = []
    if "exclusions" in tables and len(tables["exclusions"]):
        rows = tuple(
            (r.stage, _text(r.subject), _text(r.reason), str(r.rows), r.by) for r in tables["exclusions"].itertuples()
        )
        listings.append(Listing(("stage", "subject", "reason", "rows", "by"), rows, caption="Rows of raw files"))
    listings += _rejected_points(tables)
    lead = "Nothing was left out." if not listings else "Every exclusion, counted, with its reason."
    return Section("excluded", "Left out", lead, listings=tuple(listings))


def _rejected_points(tables: Tables) -> list[Listing]:
    if "residuals" not in tables:
        return []
    out = tables["residuals"][tables["residuals"]["rejected"]]
    if not len(out):
        return []
    rows = tuple(
        (str(r.pose), r.body, r.target, ", ".join(plain(1e3 * d) for d in (r.dx_mm, r.dy_mm, r.dz_mm)), _text(r.reason))
        for r in out.itertuples()
    )
    heads = ("pose", "body", "target", "off by x, y, z (µm)", "reason")
    return [
        Listing(
            heads, rows, caption=f"{_count(len(rows), 'object point')} kept out of the poses", folded=len(rows) > 40
        )
    ]


def provenance_section(provenance: Mapping[str, Mapping[str, str]]) -> Section:
    """Which artifacts the page was made from, with the digest of everything each was made of."""
    rows = tuple(
        (name, facts.get("stage", ""), facts.get("software_version", ""), facts.get("digest", "")[:16])
        for name, facts in provenance.items()
    )
    lead = "The digest of an artifact covers its inputs, its settings and the source that made it."
    return Section(
        "provenance", "Provenance", lead, listings=(Listing(("artifact", "stage", "version", "digest"), rows),)
    )
