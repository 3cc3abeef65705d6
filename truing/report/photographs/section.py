"""Section of the photographs: results of the adjustment for points, cameras, scale bars, and rays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from truing.report.column_heads import POSE, Head
from truing.report.numbers import count_text, in_suitable_unit, plain, printed, quantity, with_uncertainty
from truing.report.page import MOST_ROWS, Listing, ReportSection
from truing.report.photographs.figures import network_picture, residual_picture
from truing.report.tables import SIGMA, Row, Tables, cell, table_or_none
from truing.schemas.photograph_artifacts import FROM_MARKER, FROM_SURVEY

_OPEN = 12
_HELD = "image_residuals.parquet"
_LENGTHS = "scale_bar_lengths.parquet"


def photographs(tables: Tables) -> ReportSection | None:
    """Return the section of the network of rays; None where points do not come from photographs."""
    points, residuals = table_or_none(tables, "object_points"), table_or_none(tables, "image_residuals")
    cameras, images = table_or_none(tables, "cameras"), table_or_none(tables, "image_orientations")
    if points is None or residuals is None or cameras is None or images is None:
        return None
    points = _with_bodies(points, tables)
    figures = (
        (
            network_picture(points, images, cameras),
            "A long ellipsoid points towards cameras that are too close to each other.",
        ),
        (
            residual_picture(residuals, cameras),
            "Noise has random directions. Neighbours with equal directions show distortion that the camera model "
            "lacks; a single long vector shows a wrong measurement.",
        ),
    )
    listings = [
        _cameras(cameras, tables),
        *_bars(tables),
        *_noise(tables),
        *_rejected(residuals),
        _points(points),
    ]
    lead = _opening_sentences(points, residuals, images, tables)
    return ReportSection("photographs", "Photographs", lead, figures, tuple(listings))


def _with_bodies(points: pd.DataFrame, tables: Tables) -> pd.DataFrame:
    """Return the object points with the bodies that the survey assigned to points without a code."""
    seen = table_or_none(tables, "observations")
    if seen is None or "point" not in seen:
        return points
    known = seen[["pose", "point", "body"]].rename(columns={"body": "of_survey"})
    both = points.merge(known, on=["pose", "point"], how="left")
    return both.assign(body=both["of_survey"].fillna(both["body"])).drop(columns="of_survey")


def _figures(tables: Tables) -> dict[tuple[str, str], float]:
    table = table_or_none(tables, "bundle_statistics")
    if table is None:
        return {}
    return {(r.figure, cell(r.subject)): float(r.value) for r in table.itertuples()}


def _opening_sentences(points: pd.DataFrame, residuals: pd.DataFrame, images: pd.DataFrame, tables: Tables) -> str:
    reported = _figures(tables)
    used = int((~residuals["rejected"]).sum())
    text = (
        f"{used:,} rays of {count_text(len(images), 'photograph')} make {count_text(len(points), 'object point')} in "
    )
    text += f"{count_text(points['pose'].nunique(), 'pose')}"
    redundancy = reported.get(("redundancy", ""))
    text += f", with a redundancy of {redundancy:,.0f}." if redundancy else "."
    sigma = points[SIGMA].to_numpy()
    text += (
        f" A coordinate is known to {quantity(float(np.sqrt(np.mean(sigma**2))), 'mm')} (rms), a ray was measured to "
    )
    rows = residuals[~residuals["rejected"]]
    text += f"{float(np.median(rows['sigma_x_px'])):.3f} px. Left out: {count_text(len(residuals) - used, 'ray')}."
    checks = table_or_none(tables, "qa")
    scale = [] if checks is None else checks.loc[checks["check"] == "scale", "message"].tolist()
    return " ".join([text, *scale])


def _cameras(cameras: pd.DataFrame, tables: Tables) -> Listing:
    strongest = _strongest(tables)
    rows = []
    for r in cameras.itertuples():
        sigma = float(r.sigma) if r.free and np.isfinite(r.sigma) else None
        unit = "" if r.unit == "1" else r.unit
        fixed_text = "" if r.free else ", held"
        rows.append(
            (
                r.camera,
                r.parameter,
                with_uncertainty(float(r.value), sigma, unit) + fixed_text,
                strongest.get(f"{r.camera} {r.parameter}", ""),
            )
        )
    heads = (
        Head("camera", "Name of the camera."),
        Head("parameter", "Parameter of the interior orientation: focal length, principal point or distortion."),
        Head("value", "Adjusted value with one standard deviation; held: not adjusted."),
        Head("most correlated", "Parameter of the camera with the strongest correlation, and the correlation."),
    )
    return Listing(heads, tuple(rows), caption="Cameras: interior orientation as adjusted", held_by="cameras.parquet")


def _strongest(tables: Tables) -> dict[str, str]:
    """Return for each parameter the one with the strongest correlation."""
    table = table_or_none(tables, "camera_correlations")
    if table is None:
        return {}
    best: dict[str, tuple[float, str]] = {}
    for r in table.itertuples():
        for parameter, partner in ((r.parameter, r.other_parameter), (r.other_parameter, r.parameter)):
            if abs(r.correlation) > abs(best.get(parameter, (0.0, ""))[0]):
                best[parameter] = (r.correlation, partner)
    return {parameter: f"{value:+.2f} with {partner}" for parameter, (value, partner) in best.items()}


def _bars(tables: Tables) -> Iterator[Listing]:
    """Return scale bars in every pose; for survey distances and marker diagonals, the pose with the largest error of
    each."""
    table = table_or_none(tables, "scale_bar_lengths")
    if table is None:
        return
    bars = table[~table["bar"].str.startswith((FROM_SURVEY, FROM_MARKER))]
    heads = (
        POSE,
        Head("bar", "Name of the scale bar."),
        Head("serves as", "Whether the bar gives the scale or only checks it."),
        Head("calibrated", "Length as calibrated, with one standard deviation."),
        Head("adjusted", "Length after the bundle adjustment, with one standard deviation."),
        Head("difference", "Adjusted minus calibrated length, with one standard deviation."),
    )
    if len(bars):
        rows = tuple((str(r.pose), r.bar, r.serves, *_length(r)) for r in bars.itertuples())
        yield Listing(heads, rows, caption="Scale bars", folded=len(rows) > _OPEN, held_by=_LENGTHS)
    for start, title in ((FROM_SURVEY, "Distances of the survey"), (FROM_MARKER, "Diagonals of markers and boards")):
        of_kind = table[table["bar"].str.startswith(start)]
        if not len(of_kind):
            continue
        standardised = (of_kind["deviation_mm"] / of_kind["deviation_sigma_mm"]).abs().fillna(0.0)
        worst = of_kind.loc[standardised.groupby(of_kind["bar"], sort=False).idxmax()]
        bar_rows = tuple((r.bar.removeprefix(start), str(r.pose), *_length(r)) for r in worst.itertuples())
        caption = f"{title} that define the scale ({len(bar_rows)}), each in the pose with its largest deviation"
        yield Listing((_DISTANCE, POSE, *heads[3:]), bar_rows, (), caption, len(bar_rows) > _OPEN, _LENGTHS)


_DISTANCE = Head("distance", "Names of the two points.")


def _length(r: Row) -> tuple[str, str, str]:
    """Return a calibrated and an adjusted length, and their difference."""
    # A bar that alone defines the scale differs only by rounding.
    reported = r.deviation_sigma_mm > 1e-9 * r.length_mm
    return (
        with_uncertainty(r.length_mm, r.sigma_mm, "mm"),
        with_uncertainty(r.adjusted_mm, r.adjusted_sigma_mm, "mm"),
        printed(in_suitable_unit(r.deviation_mm, r.deviation_sigma_mm, "mm")) if reported else "0",
    )


def _noise(tables: Tables) -> Iterator[Listing]:
    reported = _figures(tables)
    rows = tuple(
        (
            subject,
            with_uncertainty(value, reported.get(("noise over stated, sigma", subject))),
            plain(reported.get(("redundancy of a component", subject))),
        )
        for (figure, subject), value in reported.items()
        if figure == "noise over stated"
    )
    if rows:
        heads = (
            Head("camera, kind", "Camera, and kind of target in its images."),
            Head(
                "noise over stated",
                "Noise of the image coordinates divided by the stated one, with one standard deviation.",
            ),
            Head("redundancy", "Mean redundancy of an image coordinate: 0 unchecked, 1 fully checked by the others."),
        )
        yield Listing(heads, rows, caption="Noise of the image coordinates, from the residuals")


def _rejected(residuals: pd.DataFrame) -> Iterator[Listing]:
    """Return the rejected rays, one table per reason, to fit the page."""
    left = residuals[residuals["rejected"]]
    left = left.assign(size=np.hypot(left["vx_px"], left["vy_px"]), reason=left["reason"].map(cell))
    left = left.sort_values("size", ascending=False, kind="stable")
    heads = (
        POSE,
        Head("image", "Name of the photograph."),
        Head("point", "Name of the target, or its kind where it has no name."),
        Head("at x, y (px)", "Place in the photograph; x to the right, y downwards."),
        Head("residual (px)", "Measured minus adjusted place in the photograph, along x and y."),
    )
    for reason, count_of in left["reason"].value_counts().items():
        rows = tuple(_ray(r) for r in left[left["reason"] == reason].head(MOST_ROWS).itertuples())
        caption = f"Rays left out ({count_of:,}): {reason}"
        yield Listing(heads, rows, caption=caption, folded=len(rows) > _OPEN, held_by=_HELD, total=count_of)


def _ray(r: Row) -> tuple[str, ...]:
    residual_text = f"{r.vx_px:+.2f}, {r.vy_px:+.2f}" if np.isfinite(r.vx_px) else "–"
    return str(r.pose), r.image, r.point or f"a {r.kind}", f"{r.x_px:.1f}, {r.y_px:.1f}", residual_text


def _points(points: pd.DataFrame) -> Listing:
    rows = tuple(
        (
            str(r.pose),
            r.point,
            ", ".join(with_uncertainty(getattr(r, f"{a}_mm"), getattr(r, f"sigma_{a}_mm")) for a in "xyz"),
            str(r.rays),
            f"{r.largest_angle_deg:.0f}",
        )
        for r in points.head(MOST_ROWS).itertuples()
    )
    heads = (
        POSE,
        Head("point", "Name of the target."),
        Head("x, y, z (mm)", "Adjusted coordinates, with one standard deviation."),
        Head("rays", "Number of photographs that show the point."),
        Head("angle (deg)", "Widest angle between two of its rays."),
    )
    return Listing(
        heads,
        rows,
        caption=f"All {len(points):,} object points, with the widest angle between their rays",
        folded=True,
        held_by="object_points.parquet",
        total=len(points),
    )
