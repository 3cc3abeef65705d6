"""What is to be said of the absorption map: which parameters swallow an effect, and whether the fit did the same."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.calibration.calibrations import Key
from truing.report.numbers import count, plain, with_uncertainty
from truing.report.parameter_names import name_of, shown_in
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

_EFFECTS = {
    "platform-deformation-linear": "the linear deformation of the platform",
    "platform-deformation-matrix": "the deformation of the platform",
}
_ESTIMATORS = {"implicit": "implicit objectives", "errors-in-variables": "maximum likelihood"}
_CLEAR = 4.0  # sigmas, beyond which not one of some hundred shifts comes by chance
# How many parameters a sentence names.
_NAMED = 3


Group = tuple[str, str, str]  # effect, deformation, estimator


def absorbed_by(tables: Tables, key: Key) -> pd.DataFrame | None:
    """The absorption by a calibration's model of the structure, with the tolerance of each parameter that has one."""
    table = filled(tables, "absorption")
    if table is None:
        return None
    own = table[table["model"] == key[0]] if (table["model"] == key[0]).any() else table
    fitted = filled(tables, "calibration")
    if fitted is None or "tolerance" not in fitted:
        return own.assign(tolerance=float("nan"))
    names = ["model", "deformation", "leg", "parameter"]
    return own.merge(fitted[[*names, "tolerance"]].drop_duplicates(names), on=names, how="left")


def group_words(group: Group) -> str:
    """What is left out of which fit: ``the deformation of the platform is ignored (implicit objectives)``."""
    return f"{effect_words(*group[:2])} ({_ESTIMATORS.get(group[2], group[2])})"


def effect_words(effect: str, deformation: str) -> str:
    """What is left out: ``the deformation of the platform is ignored``."""
    words = _EFFECTS.get(effect, effect)
    return f"{words} is ignored" if deformation == "none" else f"{words} is taken as {deformation}"


def groups(absorbed: pd.DataFrame) -> list[tuple[Group, pd.DataFrame]]:
    """Rows by effect, deformation model and estimator, those that bend parameters farthest first."""
    parts = [(key, rows) for key, rows in absorbed.groupby(["effect", "deformation", "estimator"], sort=False)]
    return sorted(parts, key=lambda part: -_largest(part[1]))


def leading_groups(absorbed: pd.DataFrame) -> list[tuple[Group, pd.DataFrame]]:
    """Of every estimator the group that bends parameters farthest."""
    found: dict[str, tuple[Group, pd.DataFrame]] = {}
    for key, rows in groups(absorbed):
        found.setdefault(key[2], (key, rows))
    return list(found.values())


def _largest(rows: pd.DataFrame) -> float:
    return float(np.nanmax(np.append(_size(rows), 0.0)))


def _size(rows: pd.DataFrame) -> Any:
    """How far a parameter is predicted to go: in its tolerances, where none has one in standard deviations."""
    scale = rows["tolerance"] if rows["tolerance"].notna().any() else rows["sigma"]
    return np.abs(rows["predicted"] / scale).to_numpy(dtype=float)


def swallowed(absorbed: pd.DataFrame | None) -> str:
    """The parameters that take most of the effect that bends the model most; empty where none is known.

    Only what stands out of its own uncertainty and comes up to a tolerance is named.
    """
    if absorbed is None or not len(absorbed):
        return ""
    clear = absorbed[absorbed["predicted"].abs() > _CLEAR * absorbed["sigma"]]
    clear = clear[_size(clear) >= 1.0] if len(clear) else clear
    if not len(clear):
        return "No deformation that was measured would move a parameter by its tolerance if it were left out."
    group, rows = groups(clear)[0]
    top = rows.assign(size=_size(rows)).nlargest(_NAMED, "size", keep="first")
    return f"If {group_words(group)}, {'; '.join(_taken(r) for r in top.itertuples())}."


def _taken(r: Any) -> str:
    factor, unit = shown_in(r.parameter, r.unit)
    said = f"{name_of(r.parameter, r.leg)} takes {plain(factor * r.predicted)} {unit}".strip()
    if r.tolerance == r.tolerance:
        said += f", {r.size:.0f} tolerances" if r.size >= 9.5 else f", {r.size:.1f} tolerances"
    if r.observed == r.observed:
        said += f" (the fit: {with_uncertainty(factor * r.observed, factor * r.sigma, unit)})"
    return said


def agreement(absorbed: pd.DataFrame) -> str:
    """How closely the fit did what linear algebra had predicted."""
    both = absorbed.dropna(subset=["predicted", "observed", "sigma"])
    off = ((both["observed"] - both["predicted"]) / both["sigma"]).abs()
    within = int((off <= 1.96).sum())
    said = f"{within} of {count(len(both), 'parameter')} lie within their bars of the line"
    return f"{said}; what is far off it is too large for linear algebra, or has another cause besides."


def correlation(predicted: Any, observed: Any) -> float | None:
    """Correlation of two lists, where there are enough of them and both vary."""
    x, y = np.asarray(predicted, float), np.asarray(observed, float)
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 3 or np.ptp(x[known]) == 0.0 or np.ptp(y[known]) == 0.0:
        return None
    return float(np.corrcoef(x[known], y[known])[0, 1])
