"""First screen of the page: which machine, instrument, dates and counts; one change of an error; three links."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np

from truing.report.axis_page import ENCODERS
from truing.report.chain_corrections import nominal_errors
from truing.report.diagnosis.assessed_causes import assessed_causes, modelled_of
from truing.report.diagnosis.prediction_errors import Overall, PartNames, errors_of_models, part_names
from truing.report.measured_section import campaign_span
from truing.report.numbers import (
    TOO_LARGE,
    count_text,
    in_suitable_unit,
    listed,
    plain,
    printed,
    sign,
    with_uncertainty,
)
from truing.report.page import CampaignFacts, ErrorChange, FirstScreen
from truing.report.scene.frames import leg_joints
from truing.report.scene.machine_drawing import machine_drawing
from truing.report.tables import Tables, in_channel_order, load_steps, signal_names, table_or_none

_CORRECTED = 1.1  # times the error that remains: the nominal geometry is worth a number
_GEOMETRY = "nominal → identified geometry, base and tool fitted in both"
_FEWEST = 3  # poses for an uncertainty by their scatter
_LINKS = (
    ("diagnosis", "What was found"),
    ("next", "What to do next"),
    ("stop", "Can I stop measuring?"),
)
_WITHOUT_DIAGNOSIS = (("diagnosis", "Why no cause was sought"), ("uncertainty", "How uncertain are the results?"))
_NO_DATE = "date not given ([certificate] begin, end)"
_DATES = (1.0e9, 4.0e9)  # seconds since 1970 that are dates of measurements: 2001 to 2096


def first_screen(tables: Tables, about: CampaignFacts) -> FirstScreen:
    """Return the first screen of a run's page."""
    facts = (
        ("machine", "; ".join(filter(None, (about.item, about.machine or _machine(tables))))),
        ("instrument", _instrument(tables, about)),
        ("measured", _when(tables, about)),
        ("data", counts(tables)),
        ("laboratory", about.laboratory),
        ("customer", about.customer),
        ("operator", about.operator),
        ("page", ", ".join(filter(None, (about.made, f"truing {about.version}" if about.version else "")))),
    )
    shown = tuple((quantity, value) for quantity, value in facts if value)
    return FirstScreen(shown, machine_drawing(tables), _change(tables), _links(tables))


def _links(tables: Tables) -> tuple[tuple[str, str], ...]:
    """Return the three sections that a reader opens first; others if no cause was sought."""
    if "diagnosis" not in tables:
        return ()
    if table_or_none(tables, "diagnosis") is not None:
        return _LINKS
    measured = "positioning" if table_or_none(tables, "positioning") is not None else "poses"
    return ((measured, "What was measured"), *_WITHOUT_DIAGNOSIS)


def _machine(tables: Tables) -> str:
    """Return the kind of machine as far as the tables contain it."""
    joints = table_or_none(tables, "joints")
    if joints is not None:
        return f"open chain, {count_text(int((joints['input'] >= 0).sum()), 'joint')}"
    frames = table_or_none(tables, "frames")
    if frames is not None:
        kind = "force sensor" if (frames["frame"] == "measurement").any() else "platform on legs"
        return f"{kind}, {count_text(len(leg_joints(frames)[0]), 'leg')}"
    axis = table_or_none(tables, "axis_errors")
    if axis is not None:
        return "rotary axis" if axis["command_unit"].eq("deg").all() else "linear axis"
    if table_or_none(tables, "signals") is not None:
        return "force sensor without [mechanism]"
    positions, shape = table_or_none(tables, "positions"), table_or_none(tables, "shape")
    if positions is not None:
        axes = list(map(str, positions["run"].unique()))
        return f"{'axis' if len(axes) == 1 else 'axes'} {listed(axes)}"
    poses = table_or_none(tables, "poses") if shape is None else None
    bodies = shape["body"] if shape is not None else poses["body"] if poses is not None else None
    return "" if bodies is None else f"bodies: {listed(list(map(str, bodies.unique())))}"


def _instrument(tables: Tables, about: CampaignFacts) -> str:
    """Return the instruments in words: kinds of data, and the equipment that campaign.toml names."""
    kinds = []
    images, readings, signals = (table_or_none(tables, n) for n in ("image_orientations", "readings", "signals"))
    if images is not None:
        cameras = table_or_none(tables, "cameras")
        cameras_text = "" if cameras is None else f" by {count_text(cameras['camera'].nunique(), 'camera')}"
        kinds.append(f"{count_text(len(images), 'photograph')}{cameras_text}, bundle adjustment")
    elif table_or_none(tables, "observations") is not None:
        kinds.append("3-D points of targets")
    if table_or_none(tables, "scans") is not None:
        kinds.append("dense scans")
    if readings is not None:
        kinds.append(f"interferometer: {' '.join(in_channel_order(readings['channel'].unique()))}")
    if signals is not None:
        kinds.append(count_text(len(signal_names(tables)), "signal"))
    if not kinds and (poses := table_or_none(tables, "poses")) is not None and (poses["method"] == "measured").any():
        kinds.append("poses of bodies, measured as such")
    if not kinds and (rows := table_or_none(tables, "axis_errors")) is not None:
        kinds += [ENCODERS[name] for name in ENCODERS if (rows["encoder"] == name).any()]
    if not kinds and table_or_none(tables, "positions") is not None:
        kinds.append("positions of an axis")
    return "; ".join(filter(None, (about.instrument, ", ".join(kinds))))


def _when(tables: Tables, about: CampaignFacts) -> str:
    """Return first and last day of the measurement, and how long it took."""
    days, span = " to ".join(dict.fromkeys(about.measured or _days(tables))), campaign_span(tables)
    return ", ".join(filter(None, (days, span))) if days else "; ".join(filter(None, (span, _NO_DATE)))


def _days(tables: Tables) -> tuple[str, ...]:
    """Return first and last day (UTC) of times that are seconds since 1970; empty for other times."""
    configurations = table_or_none(tables, "configurations")
    table = load_steps(tables) if configurations is None else configurations
    times = table["time_s"].dropna().to_numpy(dtype=float) if "time_s" in table else np.zeros(0)
    if not len(times) or times.min() < _DATES[0] or times.max() > _DATES[1]:
        return ()
    return tuple(f"{datetime.fromtimestamp(float(t), UTC):%Y-%m-%d}" for t in (times.min(), times.max()))


def counts(tables: Tables) -> str:
    """Return numbers of poses, points, runs, load steps and readings, and of points left out."""
    parts: list[str] = []
    configurations, points = table_or_none(tables, "configurations"), table_or_none(tables, "observations")
    if configurations is not None:
        roles = ", ".join(f"{n:,} {role}" for role, n in configurations["role"].value_counts().items())
        unit = "pose" if table_or_none(tables, "axis_errors") is None else "row"
        gross_errors = gross_errors_of_axis(tables)
        left = f"; {count_text(gross_errors, 'gross error')} left out" if gross_errors else ""
        parts.append(f"{count_text(len(configurations), unit)} ({roles}){left}")
    elif points is not None:
        parts.append(count_text(points["pose"].nunique(), "pose"))
    if points is not None:
        targets = points[["body", "target"]].drop_duplicates()
        parts.append(f"{count_text(len(points), 'point')} of {count_text(len(targets), 'target')}{_left_out(tables)}")
    steps, readings = load_steps(tables), table_or_none(tables, "readings")
    if len(steps):
        parts.append(f"{count_text(steps['run'].nunique(), 'run')}, {count_text(len(steps), 'load step')}")
    if readings is not None:
        parts.append(count_text(len(readings), "reading"))
    positions = table_or_none(tables, "positions")
    if positions is not None and not parts:
        targets = positions[["run", "target_mm"]].drop_duplicates()
        parts.append(f"{count_text(len(positions), 'position')} at {count_text(len(targets), 'target')}")
    return "; ".join(parts)


def gross_errors_of_axis(tables: Tables) -> int:
    """Return the number of readings of an axis that the diagnosis left out as gross errors; 0 for other campaigns."""
    rows = table_or_none(tables, "diagnosis_left_out")
    return 0 if rows is None or table_or_none(tables, "axis_errors") is None else len(rows)


def _left_out(tables: Tables) -> str:
    residuals = table_or_none(tables, "residuals")
    rejected = 0 if residuals is None else int(residuals["rejected"].sum())
    return f", {rejected:,} left out" if rejected else ""


def _change(tables: Tables) -> ErrorChange | None:
    """Return the rms error without and with the causes on held-out data, or else on fitted data."""
    rows = assessed_causes(tables)
    errors = errors_of_models(rows, modelled_of(rows), tables) if rows else []
    if not errors:
        return None
    error_of_role, parts = errors[0], part_names(tables)
    # Rows left out in turn have no rows of their own: their number is that of the fitted ones.
    *sigma, note = _sigmas(
        error_of_role, parts, tables, error_of_role.freedom or max(error.freedom for error in errors)
    )
    before, after = (
        _size(size, s, error_of_role.unit)
        for size, s in zip((error_of_role.before, error_of_role.after), sigma, strict=True)
    )
    quantity = f"rms of measured minus predicted, {parts.held_out if error_of_role.held_out else parts.fitted}"
    floor = "" if error_of_role.floor is None else _size(error_of_role.floor, None, error_of_role.unit)
    nominal = None if modelled_of(rows) else nominal_errors(tables)
    if nominal is not None and nominal.unit == error_of_role.unit and nominal.nominal > _CORRECTED * nominal.identified:
        return ErrorChange(quantity, _size(nominal.nominal, None, error_of_role.unit), after, floor, note, _GEOMETRY)
    return ErrorChange(quantity, before if modelled_of(rows) else "", after, floor, note)


def _size(size: float, sigma: float | None, unit: str) -> str:
    if size >= TOO_LARGE:
        return printed(in_suitable_unit(size, sigma, unit))
    return with_uncertainty(size, sigma, sign(unit)) if sigma is not None else f"{plain(size)} {sign(unit)}".rstrip()


def _sigmas(
    overall: Overall, parts: PartNames, tables: Tables, freedom: float
) -> tuple[float | None, float | None, str]:
    """Return the standard deviations of both rms, and their kind: by the scatter of the poses' mean squares; without
    poses by noise, from ``freedom``, the least number of independent values that were predicted."""
    poses = table_or_none(tables, "prediction")
    rows = None if poses is None else poses[poses["role"].eq("verification") == overall.held_out]
    if rows is not None and len(rows) >= _FEWEST:
        squares = rows[["rms_before", "rms_after"]].dropna().to_numpy(dtype=float) ** 2
        scatter = squares.std(axis=0, ddof=1) / math.sqrt(len(squares))
        before, after = scatter / (2.0 * np.sqrt(squares.mean(axis=0)))
        return (
            float(before),
            float(after),
            f"± one standard deviation, by the scatter of {count_text(len(squares), parts.single)}",
        )
    if not freedom > 0.0:
        return None, None, "without ±: the number of independent values is not known"
    before, after = (sigma_of_rms(size, overall.after, freedom) for size in (overall.before, overall.after))
    return before, after, f"± one standard deviation by noise, from {freedom:,.0f} independent values or more"


def sigma_of_rms(rms: float, noise: float, values: float) -> float:
    """Return the standard deviation of the rms of a number of independent values, each a fixed error plus noise.

    The mean square has variance (4 noise² rms² - 2 noise⁴) / values; without a fixed error the result is
    rms / sqrt(2 values).
    """
    size = max(rms, noise)
    return noise / size * math.sqrt((2.0 * size**2 - noise**2) / (2.0 * values)) if size > 0.0 else 0.0
