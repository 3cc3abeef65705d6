"""The section of the deformation: the picture, the shifts against their drives, the models and their errors."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from truing.report.deformation import figures as deformation_figures
from truing.report.figure_style import label
from truing.report.model_tests import ModelTest, by_p, listing_of
from truing.report.numbers import p_equals, p_value, quantity
from truing.report.page import Listing, Section
from truing.report.reasons import why_no_deformation
from truing.report.scene.by_leg import by_leg
from truing.report.scene.of_poses import pose_scene
from truing.report.scene.view import picture
from truing.report.tables import Tables, cell, filled

if TYPE_CHECKING:
    import pandas as pd

Drawn = list[tuple[object, str]]
_KEYS = ["body", "target", "axis"]
_COORDINATES_SHOWN = 6
_UNLIKELY = 0.01  # that chance does what a model explains
# An arrow of three targets says nothing that a rigid fit to them has not taken away.
_TARGETS_OF_A_PICTURE = 3


def deformation(tables: Tables) -> Section | None:
    """The deformation picture, the shifts against their drives, and the models."""
    if "deformation" not in tables:
        return None
    modelled = filled(tables, "deformation_errors") is not None
    shown = [*_picture(tables), *_legs(tables), *_targets(tables)]
    if not modelled:
        why = why_no_deformation(tables)
        return Section("deformation", "Deformation", why, tuple(shown), _legwise(tables), "not evaluated")
    tests = _tests(tables)
    listings = (listing_of(tests, "Tests of the models"), *_legwise(tables), _errors(tables))
    return Section("deformation", "Deformation", _sentence(tables), tuple(shown), listings, tests[0].state)


def _tests(tables: Tables) -> list[ModelTest]:
    """Whether the body is rigid, and which models earn their parameters."""
    facts = tables["deformation_errors"]
    found = {}
    for model, figure in (("linear", "p_value_over_none"), ("matrix", "p_value_over_linear")):
        p = facts.loc[(facts["model"] == model) & (facts["figure"] == figure), "value"].dropna()
        found[model] = float(p.min()) if len(p) else None
    told = [p for p in found.values() if p is not None]
    earned = ("It explains no more than chance.", "It explains what chance does not.")
    rigid = by_p(
        "the body is rigid: nothing in it follows the drives",
        min(1.0, len(told) * min(told)) if told else None,
        _UNLIKELY,
        ("No model explains more than chance.", "What moves in the body follows the drives beyond chance."),
        "No model could be fitted.",
    )
    asked = {
        "linear": "each place moves with its own drive (linear over none)",
        "matrix": "places move with the other drives too (matrix over linear)",
    }
    why = "This campaign does not allow the model: too few poses, or no attachment for each actuator."
    earning = [
        by_p(words, None if p is None else 1.0 - p, 1.0 - _UNLIKELY, earned[::-1], why)
        for model, words in asked.items()
        for p in [found[model]]
    ]
    return [rigid, *(replace(test, p=p) for test, p in zip(earning, found.values(), strict=True))]


def _legwise(tables: Tables) -> tuple[Listing, ...]:
    told = by_leg(tables)
    return (told,) if told.rows else ()


def _picture(tables: Tables) -> Drawn:
    shape, residuals = filled(tables, "shape"), filled(tables, "residuals")
    if shape is None or residuals is None:
        return []
    part = _without_gross_attachments(residuals, shape, tables.get("deformation"))
    part = part[~part["rejected"]].dropna(subset=["dx_mm"]).merge(shape[["body", "target"]], on=["body", "target"])
    body = _body_of_picture(part)
    if body is None:
        return []
    words = f"Targets of {body}; the slider begins with the poses in which they are farthest from their places. "
    words += "Noise is amplified as well."
    if shape.loc[shape["body"] == body, "leg"].notna().any():
        words += (
            " The grey ring joins the attachments where they were surveyed, the orange one where they are measured."
        )
    scene = pose_scene(tables, part[part["body"] == body], body)
    if scene.legs:
        words += " Legs that are chosen show their joints, their targets and their numbers."
    subtitle = f"Each line runs from a target's place to where it is measured, at first {scene.gain:g} times as long"
    return [(picture(scene, f"Displacement of the targets of {label(body)}, amplified", subtitle), words)]


def _body_of_picture(residuals: pd.DataFrame) -> str | None:
    """The platform; without one, the body that a rigid motion explains least."""
    enough = residuals.groupby("body")["target"].nunique() >= _TARGETS_OF_A_PICTURE
    size = (residuals[["dx_mm", "dy_mm", "dz_mm"]] ** 2).sum(axis=1).groupby(residuals["body"]).median()
    size = size[enough]
    if not len(size):
        return None
    return "platform" if "platform" in size.index else str(size.idxmax())


def _without_gross_attachments(
    residuals: pd.DataFrame, shape: pd.DataFrame, shifts: pd.DataFrame | None
) -> pd.DataFrame:
    """Residuals less the attachments that were left out of the deformation models as gross errors."""
    if shifts is None or not len(shifts) or "rejected" not in shifts:
        return residuals
    gross = shifts.loc[shifts["rejected"], ["pose", "leg"]].assign(gross=True)
    legs = residuals.merge(shape[["body", "target", "leg"]], on=["body", "target"], how="left")
    marked = legs.merge(gross, on=["pose", "leg"], how="left")["gross"].notna().to_numpy()
    return residuals[~marked]


def _legs(tables: Tables) -> Drawn:
    shifts, models = filled(tables, "deformation"), filled(tables, "deformation_models")
    if shifts is None or models is None:
        return []
    words = "Points off the line by more than their bars: what the other actuators do."
    drawn: Drawn = [(deformation_figures.shift_against_drive(shifts, models), words)]
    if (models["model"] == "matrix").any():
        words = (
            "Row: attachment that shifts. Column: actuator that moves it. The diagonal is what the linear model knows."
        )
        drawn.append((deformation_figures.coefficient_map(models), words))
    return drawn


def _targets(tables: Tables) -> Drawn:
    shifts, models = filled(tables, "target_deformation"), filled(tables, "deformation_models")
    if shifts is None or models is None or "drive" not in models or "configurations" not in tables:
        return []
    return [_against(shifts, models, tables["configurations"], str(d)) for d in models["drive"].dropna().unique()]


def _against(shifts: pd.DataFrame, models: pd.DataFrame, readings: pd.DataFrame, drive: str) -> tuple[object, str]:
    own = models[models["drive"] == drive].assign(z=lambda t: (t["coefficient"] / t["sigma"]).abs())
    top = own.nlargest(_COORDINATES_SHOWN, "z", keep="first")
    chosen = shifts.merge(top[_KEYS], on=_KEYS)
    figure = deformation_figures.target_against_drive(
        chosen, readings.set_index("pose")[drive], top.set_index(_KEYS)["coefficient"]
    )
    clear = int(own["significant"].sum()) if "significant" in own else 0
    return figure, f"{clear} of {len(own)} coordinates follow it beyond chance."


def _sentence(tables: Tables) -> str:
    facts = tables["deformation_errors"].set_index(["model", "figure"])["value"]
    words = []
    if ("matrix", "p_value_over_linear") in facts:
        p = float(facts[("matrix", "p_value_over_linear")])
        verb = "earns" if p < 0.01 else "does not earn"
        words.append(f"The matrix model {verb} its parameters over the linear one (p {p_equals(p)}).")
    elif ("linear", "p_value_over_none") in facts:
        p = float(facts.xs(("linear", "p_value_over_none")).min())
        earns = "earns" if p < 0.01 else "does not earn"
        words.append(f"The linear model {earns} its parameters over none (p {p_equals(p)}).")
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


def _errors(tables: Tables) -> Listing:
    rows = tuple(
        (
            r.model,
            "all" if r.leg != r.leg else f"leg {int(r.leg)}",
            cell(getattr(r, "subject", None)),
            r.figure.replace("_", " "),
            p_value(r.value) if "p_value" in r.figure else quantity(r.value, r.unit),
        )
        for r in tables["deformation_errors"].itertuples()
    )
    heads = ("model", "of", "subject", "figure", "value")
    return Listing(
        heads, rows, caption="Error figures of every model", folded=True, held_by="deformation_errors.parquet"
    )
