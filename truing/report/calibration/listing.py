"""Tables of the calibrations side by side, and of parameters that cannot be told apart well."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from truing.report.numbers import p_value, plain
from truing.report.page import Listing
from truing.report.parameter_names import UNBROKEN, name_of

if TYPE_CHECKING:
    import pandas as pd

GOOD = ("ok", "converged")
_HEADS = (
    "choice",
    "model",
    "deformation",
    "fitted (µm)",
    "(arcsec)",
    "held out (µm)",
    "(arcsec)",
    "held out / noise",
    "p",
    "rms pull",
    "χ² / freedom",
)
_ERRORS = "Errors: mean / maximum. p: of the held-out ones by chance. Equal: cannot be told from the chosen one"
_SAID = {"chosen": "chosen", "indistinguishable": "equal"}
_MARKS = {"": "", "chosen": "pass", "equal": "none"}
_STRONG = 0.9
_OPEN = 12


def all_calibrations(figures: pd.DataFrame, fitted: pd.DataFrame | None, caption: str, folded: bool = False) -> Listing:
    """A row per model and deformation: errors (mean / maximum) where it was fitted and held out, and how it fits."""
    ended = _status(fitted)
    rows = tuple(_row(key, dict(row), ended.get(key, "")) for key, row in figures.iterrows())
    marks = tuple(_MARKS.get(row[0], "warn") for row in rows)
    return Listing(_HEADS, rows, marks, f"{caption}. {_ERRORS}", folded, "model_choice.parquet")


def _status(fitted: pd.DataFrame | None) -> dict[Any, str]:
    if fitted is None or "status" not in fitted:
        return {}
    return {key: str(status) for key, status in fitted.groupby(["model", "deformation"])["status"].first().items()}


def _row(key: Any, figures: dict[str, float], status: str) -> tuple[str, ...]:
    chosen = next((word for name, word in _SAID.items() if figures.get(name) == 1.0), "")
    ended = status if status and status not in GOOD else ""
    pairs = [
        f"{plain(figures.get(f'{what}_mean_{role}'))} / {plain(figures.get(f'{what}_max_{role}'))}".replace(
            " ", UNBROKEN
        )
        for role in ("calibration", "verification")
        for what in ("position", "orientation")
    ]
    return (
        ended or chosen,
        *key,
        *pairs,
        plain(figures.get("heldout_ratio")),
        p_value(figures.get("p_value")).replace(" ", UNBROKEN),
        plain(figures.get("rms_pull")),
        f"{plain(figures.get('chi_square'))} / {plain(figures.get('freedom'))}",
    )


def strong_correlations(own: pd.DataFrame) -> Listing:
    """Pairs of parameters that move together, the strongest first."""
    strong = own[own["correlation"].abs() >= _STRONG]
    strong = strong.sort_values("correlation", key=lambda r: -r.abs(), kind="stable")
    rows = tuple(
        (name_of(r.parameter, r.leg), name_of(r.other_parameter, r.other_leg), f"{r.correlation:+.3f}")
        for r in strong.itertuples()
    )
    caption = f"Correlations of {_STRONG:g} and more: only the sum or the difference of the two is well known"
    heads = ("parameter", "with", "correlation")
    return Listing(heads, rows, caption=caption, folded=len(rows) > _OPEN, held_by="correlations.parquet")
