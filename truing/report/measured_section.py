"""Section of the measured data: bodies, targets, poses, time and temperature."""

from __future__ import annotations

import numpy as np
import pandas as pd

from truing.arrays import Array
from truing.report import poses_section as pose_figures
from truing.report.column_heads import BODY, FROM, TARGET, TO, Head
from truing.report.measured_loads import duration_words, measured_loads
from truing.report.numbers import count_text, duration, plain, quantity
from truing.report.page import Listing, ReportSection
from truing.report.tables import SIGMA, XYZ, Row, Tables, cell, load_steps, table_or_none


def measured(tables: Tables) -> ReportSection | None:
    """Return the section on bodies and targets with their visibility, or on the loads of a bench; None for an axis."""
    if table_or_none(tables, "axis_errors") is not None:
        return None
    points = table_or_none(tables, "observations")
    if points is None and table_or_none(tables, "scans") is not None:
        return _measured_scans(tables)
    if points is None:
        poses = table_or_none(tables, "poses")
        given = None if poses is None else poses[poses["default"] & (poses["method"] == "measured")]
        return measured_loads(tables) if given is None or given.empty else _measured_poses(tables, given)
    survey, known = table_or_none(tables, "survey"), _known_targets(tables, points)
    listings = [_bodies(points, survey, known)]
    if table_or_none(tables, "configurations") is not None:
        listings.append(_ranges(tables["configurations"]))
    listings.append(_targets(points, survey, table_or_none(tables, "residuals")))
    picture = (pose_figures.visible_share(points, known), "A dark column is a pose in which few targets were measured.")
    if table_or_none(tables, "scans") is not None:
        listings.append(_scans(tables["scans"]))
    shown = tuple(listing for listing in listings if listing.rows)
    return ReportSection("measured", "Measured", _campaign_sentence(tables), (picture,), shown)


def _known_targets(tables: Tables, points: pd.DataFrame) -> pd.Series:
    """Return the number of targets by body, in the order of the points: all that were surveyed or ever seen."""
    names = points[["body", "target"]].drop_duplicates()
    survey = table_or_none(tables, "survey")
    if survey is not None:
        names = names.merge(survey[["body", "target"]], how="outer").drop_duplicates()
    return names.groupby("body")["target"].nunique().reindex(_in_order(points, names))


def _in_order(points: pd.DataFrame, names: pd.DataFrame) -> list[str]:
    return list(dict.fromkeys([*points["body"].drop_duplicates(), *names["body"]]))


def _bodies(points: pd.DataFrame, survey: pd.DataFrame | None, known: pd.Series) -> Listing:
    rows = []
    for body, number in known.items():
        part = points[points["body"] == body]
        survey_of_body = survey[survey["body"] == body] if survey is not None else None
        rows.append(
            (
                str(body),
                str(number),
                "–" if survey_of_body is None else str(len(survey_of_body)),
                "–" if survey_of_body is None else str(int(survey_of_body["leg"].notna().sum())),
                f"{part['pose'].nunique():,}",
                f"{len(part):,}",
                ", ".join(quantity(s, "mm") for s in part[SIGMA].median()),
            )
        )
    heads = (
        BODY,
        Head("targets", "Number of targets of the body, surveyed or seen."),
        Head("surveyed", "Number of targets with coordinates in the frame of the body."),
        Head("at attachments", "Number of targets at attachments of legs, which move if the platform deforms."),
        Head("poses", "Number of poses in which the body was measured."),
        Head("points", "Number of measured points of the body."),
        Head("median sigma x, y, z", "Median standard deviation of a coordinate, by axis."),
    )
    return Listing(heads, tuple(rows), caption="Bodies and their targets")


def _ranges(configurations: pd.DataFrame) -> Listing:
    """Return the ranges of readings and covariates."""
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
    heads = (
        Head("column", "Column of the table of configurations."),
        FROM,
        TO,
        Head("poses", "Number of poses with a value."),
    )
    return Listing(heads, rows, caption="Readings and surroundings", folded=len(rows) > 12)


def _targets(points: pd.DataFrame, survey: pd.DataFrame | None, residuals: pd.DataFrame | None) -> Listing:
    """Return every target: its place in the survey, number of observations, and number of exclusions."""
    keys = ["body", "target"]
    table = points.groupby(keys, sort=False).size().rename("seen").reset_index()
    if survey is not None:
        table = survey[[*keys, *XYZ, "leg"]].merge(table, on=keys, how="outer", sort=False)
    if residuals is not None:
        table = table.merge(residuals.groupby(keys)["rejected"].sum().reset_index(), on=keys, how="left")
    rows = tuple(_target_row(r) for r in table.itertuples())
    heads = (
        BODY,
        TARGET,
        Head("x, y, z in the survey (mm)", "Coordinates of the target in the frame of its body."),
        Head("attachment", "Leg at whose attachment the target sits; a dash for the others."),
        Head("seen in poses", "Number of poses in which the target was measured."),
        Head("left out in", "Number of poses in which its point was left out as a gross error."),
    )
    return Listing(heads, rows, caption=f"All {count_text(len(rows), 'target')}", folded=True, held_by="survey.parquet")


def _target_row(r: Row) -> tuple[str, ...]:
    position = [getattr(r, c, None) for c in XYZ]
    known = all(p is not None and p == p for p in position)
    leg = getattr(r, "leg", None)
    left_out = getattr(r, "rejected", None)
    return (
        r.body,
        r.target,
        ", ".join(f"{p:.3f}" for p in position) if known else "not surveyed",
        f"leg {int(leg)}" if leg is not None and leg == leg else "",
        "0" if cell(r.seen) == "" else str(int(r.seen)),
        str(int(left_out)) if left_out is not None and left_out == left_out and left_out else "",
    )


def _measured_scans(tables: Tables) -> ReportSection:
    sentence = _campaign_sentence(tables)
    return ReportSection("measured", "Measured", sentence, listings=(_scans(tables["scans"]),))


def _measured_poses(tables: Tables, given: pd.DataFrame) -> ReportSection:
    """Return poses that an instrument measured directly, with the columns recorded with them."""
    rows = tuple((str(body), f"{len(part):,}") for body, part in given.groupby("body", sort=False))
    listings = [Listing((BODY, _MEASURED_POSES), rows, caption="Bodies whose poses were measured")]
    if (conf := table_or_none(tables, "configurations")) is not None and _ranges(conf).rows:
        listings.append(_ranges(conf))
    were = "was" if len(given) == 1 else "were"
    text = f"{_campaign_sentence(tables)} {count_text(len(given), 'pose')} {were} measured directly, without targets."
    return ReportSection("measured", "Measured", text, listings=tuple(listings))


_MEASURED_POSES = Head("poses", "Number of poses that the instrument reported.")


def _scans(scans: pd.DataFrame) -> Listing:
    """Return the results of the registration of dense scans, body by body."""
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
    heads = (
        BODY,
        Head("scans registered", "Number of scans that gave a pose."),
        Head("points used, median", "Median number of points of a scan in the fit."),
        Head("overlap", "Share of a scan's points on the reference surface."),
        Head("rms", "Root mean square distance of the points from the reference surface."),
        Head("scatter over declared noise", "Rms distance from the reference surface divided by the declared noise."),
    )
    return Listing(heads, rows, caption="Dense scans")


def _campaign_sentence(tables: Tables) -> str:
    conf = table_or_none(tables, "configurations")
    if conf is None:
        return "No table of configurations: poses are in the order of the files."
    roles = ", ".join(f"{n:,} {role}" for role, n in conf["role"].value_counts().items())
    sentence = f"{count_text(len(conf), 'pose')} ({roles}){_time_words(conf['time_s'].to_numpy(dtype=float))}"
    if "temperature_c" in conf and conf["temperature_c"].notna().any():
        low, high = conf["temperature_c"].min(), conf["temperature_c"].max()
        sentence += f", at {low:.2f} to {high:.2f} °C"
    return sentence + "."


def campaign_span(tables: Tables) -> str:
    """Return the duration of the poses or load steps, such as ``over 3.4 h``; empty if unknown."""
    conf, steps = table_or_none(tables, "configurations"), load_steps(tables)
    words = duration_words(steps) if conf is None else _time_words(conf["time_s"].to_numpy(dtype=float))
    return words.strip(" ,")


def _time_words(times: Array) -> str:
    """Return the duration in words; empty where times merely number the poses."""
    if len(times) < 2:
        return ""
    if np.all(np.diff(np.sort(times)) == 1.0):
        return ", in a known order without times"
    if len(np.unique(times)) < len(times) and np.any(np.diff(times) < 0.0):  # of several clocks, or from zero again
        return ""
    return f" over {duration(float(np.ptp(times)))}"
