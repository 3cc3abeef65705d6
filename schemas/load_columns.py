"""Columns of loads, readings and positions of an axis."""

from __future__ import annotations

from itertools import combinations

from truing.schemas.column import Column, flag, integer, real, share, size, text

_CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz", *(f"v{number}" for number in range(1, 9)))

LOAD_COLUMNS = (
    *(real(f"f{a}_n", "N", f"force along {a} on the platform at its origin", nullable=True) for a in "xyz"),
    *(real(f"m{a}_nm", "N m", f"torque about {a} on the platform", nullable=True) for a in "xyz"),
    *(size(f"sigma_f{a}_n", "N", f"standard deviation of the force along {a}") for a in "xyz"),
    *(size(f"sigma_m{a}_nm", "N m", f"standard deviation of the torque about {a}") for a in "xyz"),
    *(
        real(f"cov_{a}_{b}", "SI", f"covariance of {a} and {b} of a wrench, N and N m")
        for a, b in combinations(("fx", "fy", "fz", "mx", "my", "mz"), 2)
    ),
    flag("is_within", "whether every component is within 1.05 times the largest load of the calibration"),
    text("response", "component of the response", choices=("dx", "dy", "dz", "rx", "ry", "rz")),
    text("load", "component of the wrench", choices=("fx", "fy", "fz", "mx", "my", "mz")),
    text("channel", "measured quantity: a motion of the platform, or a signal of the sensor", choices=_CHANNELS),
    real("reading", "", "motion of the platform since the start of the run, in the unit of its row"),
    Column("signal", "real", "signal of that channel of the force sensor", "mV", nullable=True, family=r"v[1-8]_mv"),
    text(
        "sigma_source",
        "source of the sigma of its readings: a column of samples, or the scatter about the ellipse",
        choices=("column", "ellipse"),
    ),
    text("joined_by", "rows: in the same order; step: the same run and step; time: the nearest time"),
    integer("signal_rows", "number of rows of signals", minimum=0),
    integer("load_rows", "number of rows of loads", minimum=0),
    integer("rows_matched", "number of rows of signals with a row of loads", minimum=0),
    size("largest_apart_s", "s", "largest difference of the times of joined rows"),
    size("earlier_s", "s", "the same rows are joined if the clock of the loads is moved back by less"),
    size("later_s", "s", "the same rows are joined if the clock of the loads is moved on by less"),
    integer("samples", "number of samples of the raw signals", minimum=1),
    *(real(f"{a}0", "", f"centre of the ellipse along {a}, in the unit of the signals") for a in "xy"),
    *(size(f"amplitude_{a}", "", f"semi-axis of the ellipse along {a}") for a in "xy"),
    real("lag_rad", "rad", "phase of the second signal behind the first, minus a quarter of a fringe"),
    size("radius_before", "", "standard deviation of the radius of the raw signals"),
    size("radius_after", "", "standard deviation of the radius after correction by the ellipse of all samples"),
    size(
        "radius_uncut",
        "",
        "standard deviation of the radius of the unclipped samples, after correction by their ellipse",
    ),
    size("radius_mean", "", "mean radius of the signals"),
    real("geometry", "", "part of a reading due to the declared geometry of its beam; empty if unknown", nullable=True),
    size("geometry_sigma", "", "standard deviation of that part, proportional to it", nullable=True),
    text("correction", "corrected effect", choices=("air", "material")),
    real(
        "largest", "", "largest change, in the unit of its row; empty if readings were already corrected", nullable=True
    ),
    share("cut_share", "share of samples at an end of the converter's range"),
    size("periodic_error_um", "um", "largest error of lengths without correction by the ellipse"),
    share("miscount_risk", "largest probability of a miscount in any step"),
    real("target_mm", "mm", "commanded position of the axis"),
    text("direction", "side from which the target was approached", choices=("forward", "backward")),
    integer("cycle", "number of the repeated approach", minimum=1),
    real("position_mm", "mm", "position of the axis by the reference instrument"),
    real("position_read_mm", "mm", "position as read, before the correction to 20 degC"),
    integer("row_order", "number of the row in its table as read, from 1", minimum=1),
    real("low", "", "lower end of the 95 % interval, in the unit of its row", nullable=True),
    real("high", "", "upper end of the 95 % interval, in the unit of its row", nullable=True),
    integer("case", "load case: equal loads, approached in the same way", minimum=1),
    text(
        "branch",
        "whether the load moved away from zero or back; for several loads, the largest relative to its range",
        choices=("unloaded", "loading", "unloading"),
    ),
    real("applied", "", "load along the axis of its row, N or N m", nullable=True),
    real("measured", "", "measured value, in the unit of its row"),
    real("simulated", "", "simulated value for the same quantity", nullable=True),
    size("simulated_sigma", "", "standard deviation of the simulated value", nullable=True),
    text("source", "whether a published value is computed or measured", choices=("theory", "measurement")),
    real("published", "", "published displacement at the load of its row, in its unit"),
    text("published_in", "figure or table of the publication; empty if not given", nullable=True),
    real(
        "own",
        "",
        "the same quantity in this campaign: simulated for theory, measured for a measurement (interpolated between "
        "the loads applied); empty without a simulation, or beyond the loads applied",
        nullable=True,
    ),
    size(
        "own_sigma",
        "",
        "standard deviation of this value: by tolerances if simulated, by noise if measured",
        nullable=True,
    ),
    size(
        "allowed_difference",
        "",
        "95 % limit of published minus own, by noise and tolerances of this campaign; empty without a simulation",
        nullable=True,
    ),
    real("residual", "", "measured minus fitted, in the unit of its row", nullable=True),
    text("term", "name of the term of the model"),
    real("air_temperature_c", "degC", "temperature of the air along the beams", minimum=-273.15, nullable=True),
    size("air_pressure_hpa", "hPa", "pressure of the air", nullable=True),
    real("relative_humidity_pct", "%", "humidity of the air", minimum=0.0, maximum=100.0, nullable=True),
    real("material_temperature_c", "degC", "temperature of the platform and its legs", minimum=-273.15, nullable=True),
)
