"""What is to be said of the calibrations: which model is chosen and why, and what simpler ones cost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truing.report.calibration_listing import GOOD
from truing.report.calibrations import (
    IMPLICIT,
    NOMINAL,
    Key,
    called,
    chosen_calibration,
    figures_by_calibration,
    keys_of,
)
from truing.report.numbers import count, plain, quantity
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd


def lead(tables: Tables, fitted: pd.DataFrame) -> str:
    """Which calibration is chosen, how far it misses against noise, what it gains, and who else predicts as well."""
    figures, chosen = figures_by_calibration(tables), chosen_calibration(tables)
    ended = _failures(fitted)
    if figures is None or chosen is None:
        return f"{count(len(keys_of(fitted)), 'calibration')}, none of them chosen for this campaign. {ended}".strip()
    words = [_choice(chosen, figures.loc[chosen]), _gain(tables, chosen), _rivals(tables, figures, chosen), ended]
    return " ".join(word for word in words if word)


def _choice(chosen: Key, facts: pd.Series) -> str:
    role = "verification" if _known(facts, "position_mean_verification") else "calibration"
    poses = "held-out" if role == "verification" else "calibration"
    size = _errors(facts, role)
    said = f"Chosen for this campaign: {called(chosen)}. On the {poses} poses it misses by {size} on average"
    if _known(facts, "heldout_ratio"):
        said += f"; its held-out error is {plain(facts['heldout_ratio'])} times what noise leaves"
    if _known(facts, "rms_pull"):
        said += f", and its parameters stay {plain(facts['rms_pull'])} tolerances (rms) from nominal"
    return said + "."


def _errors(facts: pd.Series, role: str) -> str:
    position, orientation = facts.get(f"position_mean_{role}"), facts.get(f"orientation_mean_{role}")
    return f"{quantity(position, 'um')} and {quantity(orientation, 'arcsec')}"


def _known(facts: pd.Series, figure: str) -> bool:
    return bool(np.isfinite(facts.get(figure, np.nan)))


def _gain(tables: Tables, chosen: Key) -> str:
    """What calibrating brings over the numbers of the drawing, where the run predicted with them."""
    nominal, figures = figures_by_calibration(tables, NOMINAL), figures_by_calibration(tables)
    figure = "position_mean_verification"
    if nominal is None or figures is None or figure not in nominal or not _known(figures.loc[chosen], figure):
        return ""
    before = nominal.loc[[key for key in nominal.index if key[0] == chosen[0]] or list(nominal.index)].iloc[0]
    times = before[figure] / figures.loc[chosen, figure]
    return f"The nominal numbers miss by {_errors(before, 'verification')} there, {plain(times)} times as far."


def _rivals(tables: Tables, figures: pd.DataFrame, chosen: Key) -> str:
    """Calibrations whose held-out error chance could not tell from the chosen one's, and how far they had to bend."""
    if "heldout_ratio" not in figures or "rms_pull" not in figures:
        return ""
    others = figures.drop(index=[chosen])
    bound = figures.loc[chosen, "heldout_ratio"] * (1.0 + _chance(tables))
    close = others[others["heldout_ratio"] <= bound]
    if not len(close):
        return f"Every other calibration predicts the held-out poses worse, {_from_to(others['heldout_ratio'])} times."
    said = f"Of the {count(len(others), 'other')}, {len(close)} predict the held-out poses about as well"
    return f"{said}, with parameters {_from_to(close['rms_pull'])} tolerances from nominal."


def _chance(tables: Tables) -> float:
    """Two relative standard deviations of an rms over six components of the held-out poses."""
    accuracy = filled(tables, "accuracy")
    if accuracy is None:
        return 0.0
    held_out = accuracy.loc[accuracy["role"] == "verification", "pose"].nunique()
    return 2.0 / np.sqrt(12.0 * held_out) if held_out else 0.0


def _from_to(values: pd.Series) -> str:
    low, high = plain(float(values.min())), plain(float(values.max()))
    return low if low == high else f"{low} to {high}"


def _failures(fitted: pd.DataFrame) -> str:
    if "status" not in fitted:
        return ""
    bad = fitted[~fitted["status"].isin(GOOD)]
    return f"{count(len(keys_of(bad)), 'calibration')} did not come to an end." if len(bad) else ""


def cost_of_models(tables: Tables) -> str:
    """How far the other models of the structure miss with the deformation of the chosen one, in its errors."""
    figures, chosen = figures_by_calibration(tables), chosen_calibration(tables)
    figure = "position_mean_verification"
    if figures is None or chosen is None or figure not in figures:
        return "Position: distance between measured and predicted origin of the platform; orientation: angle."
    same = figures.xs(chosen[1], level="deformation")[figure]
    others = same.drop(index=chosen[0]).dropna()
    said = ", ".join(f"{model} {quantity(size, 'um')}" for model, size in others.items())
    here = f"{chosen[0]} {quantity(float(same[chosen[0]]), 'um')}"
    compared = f"Held-out position error with the same deformation: {here}{', ' + said if said else ''}."
    worse = others[others > same[chosen[0]] * (1.0 + _chance(tables))]
    if not len(worse):
        return compared
    return f"{compared} Over this range the models are not alike, other than the telescope report concludes."


def method_words(tables: Tables) -> str:
    """What taking poses and readings as uncertain, and tolerances as knowledge, changes in the chosen calibration."""
    ours, theirs = figures_by_calibration(tables), figures_by_calibration(tables, IMPLICIT)
    chosen = chosen_calibration(tables)
    if ours is None or theirs is None or chosen is None or chosen not in theirs.index:
        return ""
    a, b = theirs.loc[chosen], ours.loc[chosen]
    parts = [
        f"{words} {plain(a[figure])} against {plain(b[figure])}"
        for figure, words in (("heldout_ratio", "held-out / noise"), ("rms_pull", "rms pull"))
        if figure in a and figure in b and _known(a, figure) and _known(b, figure)
    ]
    return f"For the chosen model: {', '.join(parts)}" if parts else ""
