"""The section of the poses and their uncertainty."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.numbers import count, quantity, with_uncertainty
from truing.report.page import Listing, Section
from truing.report.poses import figures as pose_figures
from truing.report.tables import Tables, filled

if TYPE_CHECKING:
    import pandas as pd

_SIGMA = ["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]
_METHODS = {
    "maximum_likelihood": "maximum likelihood against the survey",
    "procrustes": "generalised Procrustes, body shape and poses together",
    "scan": "registration of dense scans",
    "measured": "measurement of the poses themselves",
}


def poses(tables: Tables) -> Section | None:
    """Poses of every body with what their fits leave and how well they are known."""
    if "poses" not in tables:
        return None
    if not len(tables["poses"]):
        return Section("poses", "Poses", "The campaign holds no object points.", state="not evaluated")
    chosen = tables["poses"][tables["poses"]["default"]]
    good = chosen[chosen["status"] == "ok"]
    lost = chosen[chosen["status"] != "ok"]
    listings = [_lost(lost)] if len(lost) else []
    listings.append(_all(chosen))
    state = "fail" if len(lost) else "pass"
    return Section("poses", "Poses", _lead(chosen, good), _figures(tables, good), tuple(listings), state)


def _lead(chosen: pd.DataFrame, good: pd.DataFrame) -> str:
    bodies = count(good["body"].nunique(), "body")
    methods = ", ".join(_METHODS.get(m, m) for m in good["method"].unique())
    lead = f"{count(len(good), 'pose')} of {bodies}" + (f" by {methods}" if methods else "")
    lost = len(chosen) - len(good)
    if not lost and (good["method"] == "measured").all():
        return f"{lead}, taken as given: nothing was fitted."
    return f"{lead}; {lost:,} could not be determined." if lost else f"{lead}; every one could be determined."


def _figures(tables: Tables, good: pd.DataFrame) -> tuple[tuple[Any, str], ...]:
    if not len(good):
        return ()
    uncertainty = (pose_figures.pose_uncertainty(good), "Box: the middle half of the poses; points: single poses.")
    if (good["method"] == "measured").all():
        return (uncertainty,)  # nothing was fitted
    shown = good.assign(expected_um=_expected(tables, good))
    return (
        (
            pose_figures.pose_residuals(shown),
            "A pose that stands out here deserves a look at its photographs or its log.",
        ),
        uncertainty,
    )


def _expected(tables: Tables, good: pd.DataFrame) -> Any:
    """Per pose, in um, what the declared noise of points and survey leaves after six unknowns."""
    points = filled(tables, "observations")
    if points is None:
        return np.nan
    variance = _mean_variance(points)
    survey = filled(tables, "survey")
    if survey is not None:
        variance = variance.add(_mean_variance(survey), fill_value=0.0)
    free = np.clip(1.0 - 6.0 / (3.0 * np.maximum(good["n_used"], 1)), 0.0, None)
    return 1e3 * np.sqrt(good["body"].map(variance) * free)


def _mean_variance(points: pd.DataFrame) -> pd.Series:
    """Squared distance in mm² that noise moves a point of each body, on average."""
    return (points[_SIGMA] ** 2).sum(axis=1).groupby(points["body"]).mean()


def _lost(lost: pd.DataFrame) -> Listing:
    rows = []
    for (body, status), part in lost.groupby(["body", "status"], sort=False):
        named = ", ".join(str(p) for p in part["pose"].iloc[:12])
        more = f" and {len(part) - 12:,} more" if len(part) > 12 else ""
        rows.append((str(body), str(status), f"{len(part):,}", named + more))
    return Listing(("body", "why", "poses", "which"), tuple(rows), caption="Poses that could not be determined")


def _all(chosen: pd.DataFrame) -> Listing:
    rows = tuple(_pose_row(r) for r in chosen.itertuples())
    heads = ("pose", "body", "from", "x, y, z (mm)", "rotation vector (mrad)", "rms", "used", "left out", "status")
    caption = f"All {count(len(rows), 'pose')}"
    return Listing(heads, rows, caption=caption, folded=True, held_by="poses.parquet")


def _pose_row(r: Any) -> tuple[str, ...]:
    return (
        str(r.pose),
        r.body,
        r.parent,
        _three(r, "px_mm py_mm pz_mm", 0, 1.0),
        _three(r, "rx_rad ry_rad rz_rad", 3, 1e3),
        quantity(1e3 * r.rms_mm, "um"),
        str(r.n_used),
        str(r.n_rejected),
        r.status,
    )


def _three(r: Any, names: str, first: int, factor: float) -> str:
    cells = []
    for k, name in enumerate(names.split()):
        variance = getattr(r, f"cov_{first + k}_{first + k}")
        sigma = 1e3 * max(variance, 0.0) ** 0.5 if variance == variance else None
        cells.append(with_uncertainty(factor * getattr(r, name), sigma))
    return ", ".join(cells)
