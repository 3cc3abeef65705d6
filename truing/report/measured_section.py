"""What was measured: bodies, targets, poses by role, time and temperature; or loads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from truing.report.measured_loads import measured_loads
from truing.report.numbers import count, duration, plain, quantity
from truing.report.page import Listing, Section
from truing.report.poses import figures as pose_figures
from truing.report.tables import Tables, cell, filled

if TYPE_CHECKING:
    import pandas as pd

_XYZ = ["x_mm", "y_mm", "z_mm"]
_SIGMA = ["sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]


def measured(tables: Tables) -> Section | None:
    """Bodies and targets with what was seen of them, or the loads and displacements of a bench."""
    points = filled(tables, "observations")
    if points is None and filled(tables, "scans") is not None:
        return _measured_scans(tables)
    if points is None:
        poses = filled(tables, "poses")
        given = None if poses is None else poses[poses["default"] & (poses["method"] == "measured")]
        return measured_loads(tables) if given is None or given.empty else _measured_poses(tables, given)
    survey, known = filled(tables, "survey"), _known_targets(tables, points)
    listings = [_bodies(points, survey, known)]
    if filled(tables, "configurations") is not None:
        listings.append(_ranges(tables["configurations"]))
    listings.append(_targets(points, survey, filled(tables, "residuals")))
    picture = (pose_figures.targets_seen(points, known), "Where whole columns are dark, a pose was hardly measured.")
    if filled(tables, "scans") is not None:
        listings.append(_scans(tables["scans"]))
    shown = tuple(listing for listing in listings if listing.rows)
    return Section("measured", "Measured", _campaign_sentence(tables), (picture,), shown)


def _known_targets(tables: Tables, points: pd.DataFrame) -> pd.Series:
    """Number of targets by body, in the order of the points: those surveyed or ever seen."""
    names = points[["body", "target"]].drop_duplicates()
    survey = filled(tables, "survey")
    if survey is not None:
        names = names.merge(survey[["body", "target"]], how="outer").drop_duplicates()
    return names.groupby("body")["target"].nunique().reindex(_in_order(points, names))


def _in_order(points: pd.DataFrame, names: pd.DataFrame) -> list[str]:
    return list(dict.fromkeys([*points["body"].drop_duplicates(), *names["body"]]))


def _bodies(points: pd.DataFrame, survey: pd.DataFrame | None, known: pd.Series) -> Listing:
    rows = []
    for body, number in known.items():
        part = points[points["body"] == body]
        mine = survey[survey["body"] == body] if survey is not None else None
        rows.append(
            (
                str(body),
                str(number),
                "–" if mine is None else str(len(mine)),
                "–" if mine is None else str(int(mine["leg"].notna().sum())),
                f"{part['pose'].nunique():,}",
                f"{len(part):,}",
                ", ".join(quantity(s, "mm") for s in part[_SIGMA].median()),
            )
        )
    heads = ("body", "targets", "surveyed", "at attachments", "poses", "points", "median sigma x, y, z")
    return Listing(heads, tuple(rows), caption="Bodies and their targets")


def _ranges(configurations: pd.DataFrame) -> Listing:
    """From where to where readings and covariates went."""
    numeric = configurations.select_dtypes("number").columns
    columns = [c for c in numeric if c not in ("pose", "time_s")]
    rows = tuple(
        (
            c,
            f"{configurations[c].min():.6g}",
            f"{configurations[c].max():.6g}",
            str(int(configurations[c].notna().sum())),
        )
        for c in columns
    )
    return Listing(("column", "from", "to", "poses"), rows, caption="Readings and surroundings", folded=len(rows) > 12)


def _targets(points: pd.DataFrame, survey: pd.DataFrame | None, residuals: pd.DataFrame | None) -> Listing:
    """Every target: its place in the survey, how often it was seen, how often it was left out."""
    keys = ["body", "target"]
    table = points.groupby(keys, sort=False).size().rename("seen").reset_index()
    if survey is not None:
        table = survey[[*keys, *_XYZ, "leg"]].merge(table, on=keys, how="outer", sort=False)
    if residuals is not None:
        table = table.merge(residuals.groupby(keys)["rejected"].sum().reset_index(), on=keys, how="left")
    rows = tuple(_target_row(r) for r in table.itertuples())
    heads = ("body", "target", "x, y, z in the survey (mm)", "attachment", "seen in poses", "left out in")
    return Listing(heads, rows, caption=f"All {count(len(rows), 'target')}", folded=True, held_by="survey.parquet")


def _target_row(r: Any) -> tuple[str, ...]:
    place = [getattr(r, c, None) for c in _XYZ]
    known = all(p is not None and p == p for p in place)
    leg = getattr(r, "leg", None)
    left_out = getattr(r, "rejected", None)
    return (
        r.body,
        r.target,
        ", ".join(f"{p:.3f}" for p in place) if known else "not surveyed",
        f"leg {int(leg)}" if leg is not None and leg == leg else "",
        "0" if cell(r.seen) == "" else str(int(r.seen)),
        str(int(left_out)) if left_out is not None and left_out == left_out and left_out else "",
    )


def _measured_scans(tables: Tables) -> Section:
    sentence = _campaign_sentence(tables)
    return Section("measured", "Measured", sentence, listings=(_scans(tables["scans"]),))


def _measured_poses(tables: Tables, given: pd.DataFrame) -> Section:
    """Poses that an instrument gave as such, with what was recorded beside them."""
    rows = tuple((str(body), f"{len(part):,}") for body, part in given.groupby("body", sort=False))
    listings = [Listing(("body", "poses"), rows, caption="Bodies whose poses were measured")]
    if (conf := filled(tables, "configurations")) is not None and _ranges(conf).rows:
        listings.append(_ranges(conf))
    said = f"{_campaign_sentence(tables)} Poses were measured as such, without targets: {len(given):,} of them."
    return Section("measured", "Measured", said, listings=tuple(listings))


def _scans(scans: pd.DataFrame) -> Listing:
    """What the registration of dense scans made of each body's surface."""
    rows = tuple(
        (
            str(body),
            f"{int((part['status'] == 'ok').sum()):,} of {len(part):,}",
            f"{part['n_used'].median():,.0f}",
            f"{plain(100.0 * part['overlap'].median())} %",
            quantity(part["rms_mm"].median(), "mm"),
            plain(part["noise_ratio"].median()),
        )
        for body, part in scans.groupby("body", sort=False)
    )
    heads = ("body", "scans registered", "points used, median", "overlap", "rms", "scatter over declared noise")
    return Listing(heads, rows, caption="Dense scans")


def _campaign_sentence(tables: Tables) -> str:
    conf = filled(tables, "configurations")
    if conf is None:
        return "No table of configurations: poses stand in the order in which they came."
    roles = ", ".join(f"{n:,} {role}" for role, n in conf["role"].value_counts().items())
    sentence = f"{count(len(conf), 'pose')} ({roles}){_time_words(conf['time_s'].to_numpy(dtype=float))}"
    if "temperature_c" in conf and conf["temperature_c"].notna().any():
        low, high = conf["temperature_c"].min(), conf["temperature_c"].max()
        sentence += f", at {low:.2f} to {high:.2f} °C"
    return sentence + "."


def _time_words(times: Any) -> str:
    """How long it took; nothing where times merely number the poses."""
    if len(times) < 2:
        return ""
    if np.all(np.diff(np.sort(times)) == 1.0):
        return ", without times other than their order"
    return f" over {duration(float(np.ptp(times)))}"
