"""Columns of calibrations, requirements and uncertainties."""

from __future__ import annotations

from truing.schemas.column import flag, integer, real, share, size, text

_FITTED = ("errors-in-variables", "implicit", "nominal", "points")
_DEFORMING = ("none", "linear", "nonlinear", "matrix", "in-plane")
_LOAD_NAMES = ("fx", "fy", "fz", "mx", "my", "mz")
RESULTS = (
    "pose",
    "calibration",
    "accuracy",
    "cause",
    "compliance",
    "G_B",
    "G_B'",
    "load",
    "positioning",
    "chain",
    "tip",
)

LEG_JOINTS = "joints of leg"  # name of a frame in `frames`, before the number of the leg

CALIBRATION_COLUMNS = (
    text("deformation", "deformation model of the platform", choices=_DEFORMING),
    text("parameter", "name of the parameter: a_x, b_y, u_x, l, rho0, kappa, K12, ..."),
    real("nominal", "", "parameter before calibration, in the unit of its row", nullable=True),
    real("identified", "", "parameter after calibration", nullable=True),
    size("tolerance", "", "standard deviation of manufacturing and assembly; empty if none is declared", nullable=True),
    real(
        "pull",
        "",
        "difference over its standard deviation: from nominal, by tolerance and measurement; from the simulated value, "
        "by simulation and measurement",
        nullable=True,
    ),
    size("sensitivity_um", "um", "rms change of the leg's closure over the poses by one tolerance"),
    size("closure_noise_um", "um", "rms noise of this closure by poses and readings"),
    size(
        "sigma_over_tolerance",
        "",
        "standard deviation by the data alone over the tolerance; empty: none",
        nullable=True,
    ),
    flag("identifiable", "whether the data determine the parameter better than its tolerance"),
    text("effect_of", "cause and its subject; empty for the machine's own parameters", nullable=True),
    integer("other_leg", "leg of the other parameter, counted from 1", minimum=1, nullable=True),
    text("other_parameter", "other parameter of a pair"),
    real("correlation", "", "correlation of the two errors", minimum=-1.0, maximum=1.0),
    size("position_error_um", "um", "distance between measured and predicted platform origin"),
    size("orientation_error_arcsec", "arcsec", "angle between measured and predicted platform"),
    *(real(f"d{a}_um", "um", f"measured minus predicted along {a} of the base", nullable=True) for a in "xyz"),
    *(real(f"r{a}_arcsec", "arcsec", f"measured minus predicted about {a} of the base", nullable=True) for a in "xyz"),
    size("position_noise_um", "um", "rms position error by noise alone", nullable=True),
    size("orientation_noise_arcsec", "arcsec", "rms orientation error by noise alone", nullable=True),
    text("estimator", "fit method", choices=_FITTED),
    text("combination", "combination of parameters that the data do not separate, in words", nullable=True),
    text("frame", "base, platform, leg and its number, joints of a leg, or measurement"),
    text("axis_name", "axis of the frame: x, y, z; S1 .. S6 of the joints of a leg; channel of a measurement"),
    *(real(f"along_{a}", "", f"component along {a} of its unit direction, in the frame of the base") for a in "xyz"),
    text("effect", "effect that the model leaves out"),
    real("effect_change", "", "change of the simulated entry by this effect, in the unit of its row"),
    size(
        "effect_over_sigma",
        "",
        "size of this change over the standard deviation of measured minus simulated; empty without uncertainty",
        nullable=True,
    ),
    real("predicted", "", "part of the effect that the parameter absorbs, by linear algebra before the fit"),
    real("observed", "", "change of the parameter when the effect is left out of the fit", nullable=True),
    # Force sensor.
    text("matrix", "name of the matrix", choices=("G", "G'", "G_B", "G_B'", "terms")),
    text("row", "row of the matrix: a component of the wrench, or a signal"),
    text("column_name", "column of the matrix: a leg, a signal, or a term"),
    size("sigma_by_case", "", "standard deviation by leaving out load cases in turn", nullable=True),
    flag("chosen", "whether this one is chosen, by held-out loads"),
    size("length_m", "m", "length by which moments are divided; 1 m leaves them unchanged", nullable=True),
    text("error_class", "name of the error in laboratory terms"),
    text("indicated", "component that shows the error", choices=_LOAD_NAMES),
    # Comparison of calibrations, also on a second campaign.
    text("data", "calibrated data", choices=("as recorded", "with findings")),
    flag("is_main", "whether all other tables use this calibration"),
    text("findings", "causes whose effects it includes, with their subjects; empty: none", nullable=True),
    text(
        "tested_on",
        "data on which errors are computed; held-out load cases are predicted by a fit to all others",
        choices=("verification poses", "calibration poses", "held-out load cases", "verification runs"),
    ),
    size("rms_error", "", "root mean square of measured minus predicted, in the unit of its row"),
    size("largest_error", "", "largest absolute error", nullable=True),
    size(
        "rms_unchanged",
        "",
        "root mean square error of the data that no finding changes, the same for both; empty if findings change all",
        nullable=True,
    ),
    text(
        "prediction_by",
        "predicting model: nominal machine, chosen calibration, or extended model of the diagnosis",
        choices=("nominal", "calibrated", "extended"),
    ),
    size("noise_rms", "", "root mean square error by noise alone", nullable=True),
    share(
        "p_worse",
        "probability of errors this much larger than those of the nominal model, if both predict equally well: paired "
        "and one-sided, values as if independent; empty for the nominal model and for fewer than 5 values",
        nullable=True,
    ),
    integer(
        "beyond_range",
        "number of these values at readings outside the range of the fitted poses; empty if the model states no range",
        minimum=0,
        nullable=True,
    ),
    integer("count", "number of poses, load steps or readings in the root mean square", minimum=1),
    # Requirements.
    text(
        "error_source",
        "tolerance of a force sensor that moves its platform; all: every tolerance at once",
        choices=(
            *("platform_radius", "base_radius", "lower_clearance", "middle_clearance", "sensor_installation", "all"),
        ),
    ),
    text("pose_part", "position of the platform, or its attitude", choices=("position", "attitude")),
    size("tolerance_width_um", "um", "full width T of the tolerance zone, with sigma = T / 6", nullable=True),
    size("first_order", "", "rms error of the platform to first order, legs as closed loops, in the unit of its row"),
    size("sample_rms", "", "rms error of the drawn sensors in tolerance_samples.parquet, in the unit of its row"),
    size("error_95", "", "error that 95 % of all sensors do not exceed, in the unit of its row"),
    share("variance_share", "share of the source in the variance of the error by all tolerances"),
    size("open_chains", "", "rms of the mean of six open chains (force-sensor paper, eq. 14), in the unit of its row"),
    integer("sample", "number of the drawn sensor", minimum=1),
    size("platform_shift_um", "um", "distance of the platform's origin from its place as designed"),
    size("platform_turn_arcsec", "arcsec", "rotation of the platform from its attitude as designed"),
    text(
        "component",
        "position along or rotation about an axis; axis: of a single axis; force or torque of a force sensor",
        choices=("x", "y", "z", "rx", "ry", "rz", "axis", "fx", "fy", "fz", "mx", "my", "mz"),
    ),
    real("missed", "", "measured minus predicted, in the unit of its row"),
    real("requirement", "", "required accuracy, in the unit of its row", nullable=True),
    size("error", "", "error that 95 of 100 poses do not exceed", nullable=True),
    size("lower", "", "lower end of the 95 % interval of the number in this row", nullable=True),
    size("upper", "", "upper end of the 95 % interval of the number in this row", nullable=True),
    integer(
        "poses_judged",
        "number of poses (force sensor: of held-out runs) whose error was compared with the requirement",
        minimum=1,
        nullable=True,
    ),
    *(
        size(
            f"{end}_expected", "", f"expected {end} end of that interval after the proposed measurements", nullable=True
        )
        for end in ("lower", "upper")
    ),
    # Uncertainty.
    text("result", "kind of result", choices=RESULTS),
    text("quantity", "quantity of the subject"),
    real("estimate", "", "stated value, in the unit of its row", nullable=True),
    size("standard_uncertainty", "", "combined standard uncertainty of the estimate", nullable=True),
    size(
        "degrees_of_freedom",
        "",
        "degrees of freedom of the uncertainty in this row (combined: Welch-Satterthwaite); empty: infinite",
        nullable=True,
    ),
    size("coverage_factor", "", "ratio of expanded to standard uncertainty", nullable=True),
    size("expanded_uncertainty", "", "half width of the 95 % interval", nullable=True),
    flag("stated", "whether an uncertainty is stated; else reason says why not"),
    text("input_source", "source of uncertainty"),
    text(
        "evaluation",
        "A: from observations of this campaign; B: declared; not evaluated: not in the budget",
        choices=("A", "B", "not evaluated"),
    ),
    text("distribution", "assumed distribution of the source", nullable=True),
    size("contribution", "", "standard uncertainty of the result by this source", nullable=True),
    share("share_of_variance", "share in the squared uncertainty", nullable=True),
)
