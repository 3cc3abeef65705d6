"""Columns of what was measured, and of what is told of it at once: poses, residuals, deformation, quality."""

from __future__ import annotations

from truing.schemas.column import Column, real

IDENTITY = (
    Column("pose", "identifier", "the pose, as the campaign numbers or names it"),
    Column("body", "text", "the rigid body: base, platform, leg1..leg6, or any name without a mechanism"),
    Column("parent", "text", "the frame a pose is given in: a body's name, or measurement"),
    Column("target", "text", "the target on its body"),
    Column("leg", "integer", "the leg, counted from 1; empty where no leg is concerned", minimum=1, nullable=True),
    Column("run", "identifier", "the run of a loading campaign"),
    Column("step", "integer", "the load step within its run, in the order taken", minimum=0),
    Column("role", "text", "what the pose or run serves", choices=("calibration", "verification", "reference")),
    real("time_s", "s", "when it was taken; orders poses and steps"),
    Column("subject", "text", "what a row concerns; empty for the whole", nullable=True),
    Column("stage", "text", "the stage that speaks"),
    Column("reason", "text", "why it was left out; empty where it was not", nullable=True),
    Column(
        "decision",
        "text",
        "what a person decided, whatever a rule says; empty where nobody did",
        nullable=True,
        choices=("excluded", "kept"),
    ),
    Column("message", "text", "one sentence for the engineer"),
    Column("status", "text", "how the fit ended; ok, or what prevented it"),
    Column("unit", "text", "the unit of the numbers in this row", nullable=True),
    Column("model", "text", "the model: of deformation, or of the structure (6-pus, jacobian, beam, stiffness)"),
    Column("axis", "text", "the axis of the body frame", choices=("x", "y", "z"), nullable=True),
    Column("drive", "text", "the column that the response follows", nullable=True),
)

CAMPAIGN_LIFE = (
    Column("called", "text", "what the files call the target"),
    Column("from_pose", "text", "the first pose of which it holds; empty: from the first on", nullable=True),
    Column("to_pose", "text", "the last pose of which it holds; empty: to the last", nullable=True),
    Column("later_survey", "text", "the survey that is compared with those before it"),
    *(
        real(f"shift_{a}_mm", "mm", f"by how much the survey has the target elsewhere along {a}", nullable=True)
        for a in "xyz"
    ),
    real("distance_mm", "mm", "how far it lies from the target's place on the body", minimum=0.0),
    Column("entry", "text", "which entry of campaign.toml, counted from 1"),
    Column("decided_on", "text", "the day of the decision; empty where it was not written down", nullable=True),
    Column("gross_anyway", "integer", "rows that would be left out as gross errors by themselves", minimum=0),
    real(
        "largest_change",
        "",
        "by how much the result would be another at most, without the exclusions, in the unit of its row",
        minimum=0.0,
        nullable=True,
    ),
    real(
        "over_sigma",
        "",
        "that over its standard deviation; of bodies: over that of a target",
        minimum=0.0,
        nullable=True,
    ),
    Column("relocated", "flag", "whether the target lies elsewhere than before, beyond chance or as was said"),
    Column(
        "holds_as", "text", "the target as which the new place holds; empty where it holds for no pose", nullable=True
    ),
)

REPEATS = (
    Column(
        "repeat_of",
        "text",
        "the pose that this one repeats, by its name; empty where it repeats none",
        nullable=True,
    ),
    Column("repeated", "text", "what came out again", choices=("pose", "point", "attachment", "reading", "signal")),
    real("pure_error", "", "one standard deviation of a repeat, in the unit of its row", minimum=0.0),
    real("declared_sigma", "", "one standard deviation as stated, in the unit of its row", minimum=0.0, nullable=True),
    real("freedom_of_error", "", "degrees of freedom of the pure error", minimum=0.0),
    real("freedom_of_fit", "", "degrees of freedom that the model leaves beside the pure error", minimum=0.0),
    Column("groups", "integer", "how many poses or programmes of loads were repeated", minimum=1),
    Column("told_by", "text", "how repeats are known: repeat_of, the same readings, or the same loads in one order"),
    real(
        "p_equal",
        "",
        "probability that repeated groups of one scatter differ as much by chance; small: no one number holds for all",
        minimum=0.0,
        maximum=1.0,
        nullable=True,
    ),
    Column("attained", "integer", "how many times the pose was measured", minimum=2),
    Column("contender", "text", "the model that is held against pure error"),
    real("f_ratio", "", "what the model leaves beside pure error over that, per degree of freedom", minimum=0.0),
)

POINTS = (
    *(real(f"{a}_mm", "mm", f"{a} coordinate in the frame of the file") for a in "xyz"),
    *(real(f"sigma_{a}_mm", "mm", f"one standard deviation of {a}", minimum=0.0, nullable=True) for a in "xyz"),
    *(
        real(
            f"corr_{p}", "", f"correlation of the errors in {p[0]} and {p[1]}", minimum=-1.0, maximum=1.0, nullable=True
        )
        for p in ("xy", "xz", "yz")
    ),
)

CONFIGURATIONS = (
    Column("rho", "real", "actuator reading of that leg, rho0 + delta rho", "mm", family=r"rho[1-9]\d*_mm"),
    real("temperature_c", "degC", "temperature of the mechanism", minimum=-273.15, nullable=True),
    Column(
        "event",
        "text",
        "what happened before this row: a new text marks the first row after it; empty: nothing",
        nullable=True,
    ),
    Column("encoder", "text", "what recorded where an axis stands", choices=("motor", "load", "measured")),
    real("command", "", "where the axis was sent, in command_unit"),
    Column("command_unit", "text", "the unit of the axis", choices=("deg", "mm")),
    Column("approach", "integer", "direction of approach: -1 or 1", minimum=-1, maximum=1),
)

POSES = (
    Column(
        "method",
        "text",
        "the estimator; measured where the instrument gave the pose itself; model where the extended model predicts",
        choices=("umeyama", "haralick", "maximum_likelihood", "procrustes", "scan", "measured", "model"),
    ),
    Column("default", "flag", "whether this row feeds the following stages"),
    *(real(f"p{a}_mm", "mm", f"{a} of the body's origin in the parent frame", nullable=True) for a in "xyz"),
    *(real(f"r{a}_rad", "rad", f"{a} component of the rotation vector, body to parent", nullable=True) for a in "xyz"),
    *(
        real(
            f"cov_{i}_{j}", "SI", "covariance, order p then theta, R <- exp(theta) R in the parent frame", nullable=True
        )
        for i in range(6)
        for j in range(i, 6)
    ),
    real("rms_mm", "mm", "root mean square of the residuals of the targets kept", minimum=0.0, nullable=True),
    Column("n_used", "integer", "targets, points of a scan or readings that entered the fit", minimum=0),
    Column(
        "n_rejected",
        "integer",
        "targets, points of a scan or readings kept out as gross errors or by a person",
        minimum=0,
    ),
    real("overlap", "", "share of a scan's points that lie on the reference surface", minimum=0.0, maximum=1.0),
    real("noise_ratio", "", "by which the standard deviations were enlarged for what noise leaves open", minimum=1.0),
)

RESIDUALS = (
    *(real(f"d{a}_mm", "mm", f"measured minus fitted along {a}", nullable=True) for a in "xyz"),
    real("weight", "", "weight in the fit, 0 (kept out) to 1", minimum=0.0, maximum=1.0),
    Column("rejected", "flag", "whether the target was kept out as a gross error or by a person"),
)

DEFORMATION = (
    real("delta_rho_mm", "mm", "actuator displacement from its reference reading"),
    real("delta_bz_um", "um", "shift of the attachment along z of the platform, from its place in the survey"),
    real("sigma_um", "um", "one standard deviation, all known noise propagated", minimum=0.0),
    real("own_sigma_um", "um", "the part of it that the attachment's own targets bring along z", minimum=0.0),
    real(
        "scatter_sigma_um",
        "um",
        "the part of it that differs from pose to pose, where points have errors in common",
        minimum=0.0,
    ),
    real("displacement_um", "um", "shift of a target in its body frame from its place in the survey"),
    Column("significant", "flag", "whether it differs from zero at the stated false-alarm rate", nullable=True),
    Column("column", "integer", "which drive the coefficient multiplies, counted from 1; 0 is the offset", minimum=0),
    real("coefficient", "", "response per unit of drive, in the unit of its row"),
    real("sigma", "", "one standard deviation of the number beside it", minimum=0.0, nullable=True),
    real(
        "p_value",
        "",
        "probability of a deviation at least this large by chance",
        minimum=0.0,
        maximum=1.0,
        nullable=True,
    ),
    Column("figure", "text", "the name of the figure"),
    real("value", "", "the number, in the unit of its row", nullable=True),
)

_CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz", *(f"v{number}" for number in range(1, 9)))

LOADS = (
    *(real(f"f{a}_n", "N", f"force along {a} on the platform at its origin", nullable=True) for a in "xyz"),
    *(real(f"m{a}_nm", "N m", f"torque about {a} on the platform", nullable=True) for a in "xyz"),
    Column("response", "text", "component of the response", choices=("dx", "dy", "dz", "rx", "ry", "rz")),
    Column("load", "text", "component of the wrench", choices=("fx", "fy", "fz", "mx", "my", "mz")),
    Column("channel", "text", "what was read: a motion of the platform, or a signal of the sensor", choices=_CHANNELS),
    real("reading", "", "motion of the platform since the start of the run, in the unit of its row"),
    Column("signal", "real", "signal of that channel of the force sensor", "mV", nullable=True, family=r"v[1-8]_mv"),
    Column(
        "sigma_source",
        "text",
        "what gives the sigma of its readings: a column of samples, or what they leave about their ellipse",
        choices=("column", "ellipse"),
    ),
    Column("samples", "integer", "how many samples of the raw signals", minimum=1),
    *(real(f"{a}0", "", f"middle of the ellipse along {a}, in the unit of the signals") for a in "xy"),
    *(real(f"amplitude_{a}", "", f"half axis of the ellipse along {a}", minimum=0.0) for a in "xy"),
    real("lag_rad", "rad", "by how much the second signal departs from a quarter of a fringe behind the first"),
    real("radius_before", "", "standard deviation of the radius of the signals as they are", minimum=0.0),
    real("radius_after", "", "the same once the ellipse of all samples is taken out", minimum=0.0),
    real("radius_uncut", "", "the same of the samples that no end of the range cuts, by their ellipse", minimum=0.0),
    real("radius_mean", "", "mean radius of the signals", minimum=0.0),
    real(
        "geometry", "", "what the declared geometry of its beam adds to a reading; empty where unknown", nullable=True
    ),
    real("geometry_sigma", "", "one sigma of that, in proportion to it", minimum=0.0, nullable=True),
    Column("correction", "text", "what was corrected", choices=("air", "material")),
    real(
        "largest", "", "the largest change, in the unit of its row; empty where readings came corrected", nullable=True
    ),
    real("cut_share", "", "share of samples at an end of the converter's range", minimum=0.0, maximum=1.0),
    real("periodic_error_um", "um", "largest error of lengths without the ellipse's correction", minimum=0.0),
    real("miscount_risk", "", "largest probability of any step to be counted wrong", minimum=0.0, maximum=1.0),
    real("target_mm", "mm", "where an axis was sent"),
    Column("direction", "text", "the side that a target was approached from", choices=("forward", "backward")),
    Column("cycle", "integer", "which of the repeated approaches", minimum=1),
    real("position_mm", "mm", "where the axis stood, by the reference"),
    real("position_read_mm", "mm", "where the axis stood as it was read, before it was brought to 20 degC"),
    Column("row_order", "integer", "place of the row among those of its table as they were read, from 1", minimum=1),
    real("low", "", "lower end of the interval of 95 %, in the unit of its row", nullable=True),
    real("high", "", "upper end of the interval of 95 %, in the unit of its row", nullable=True),
    Column("case", "integer", "the load case: the same loads, reached the same way", minimum=1),
    Column(
        "branch",
        "text",
        "whether the load grew away from zero or came back; several loads at once: the largest in its range",
        choices=("unloaded", "loading", "unloading"),
    ),
    real("applied", "", "load along the axis of its row, N or N m", nullable=True),
    real("measured", "", "what was measured, in the unit of its row"),
    real("simulated", "", "what the simulation gives instead of the number beside it", nullable=True),
    real("simulated_sigma", "", "one standard deviation of it by the tolerances", minimum=0.0, nullable=True),
    real("residual", "", "measured minus fitted, in the unit of its row", nullable=True),
    Column("term", "text", "what a number multiplies"),
    real("air_temperature_c", "degC", "temperature of the air along the beams", minimum=-273.15, nullable=True),
    real("air_pressure_hpa", "hPa", "pressure of the air", minimum=0.0, nullable=True),
    real("relative_humidity_pct", "%", "humidity of the air", minimum=0.0, maximum=100.0, nullable=True),
    real("material_temperature_c", "degC", "temperature of the platform and its legs", minimum=-273.15, nullable=True),
)

QUALITY = (
    Column("check", "text", "the name of the check"),
    real("limit", "", "the limit that the verdict rests on, in the unit of its row", nullable=True),
    Column("accepted", "text", "who accepted the verdict and why; empty where nobody did", nullable=True),
    Column("relation", "text", "the tested relation between two parts of the campaign: the name of its check"),
    Column(
        "state",
        "text",
        "result of the test of a relation",
        choices=("ok", "attention", "fails", "not tested"),
    ),
    Column(
        "reason_code",
        "text",
        "code of the reason for the state or the verdict; of a cause: found, noise, rival, chance, held-out (predicts "
        "it worse), dropped (not needed next to others), contained (in what was found) or unseen (the campaign cannot "
        "show it)",
    ),
    real("misfit", "", "rms of what the relation leaves as recorded; a count or ratio in unit 1", nullable=True),
    real("misfit_explained", "", "the same with the slips undone; empty where no slip explains it", nullable=True),
    Column("slips", "text", "JSON list of the slips that together explain the data: kind, quantity, subjects, factor"),
    Column("rivals", "text", "JSON list of slips that explain the data as well as those"),
    Column("hidden_slips", "text", "JSON list of slips that this campaign could not show"),
    Column("tried", "integer", "number of hypotheses tried", minimum=0),
    Column("rows", "integer", "how many rows it concerns", minimum=0),
    Column("by", "text", "the rule, or the person, that left them out"),
)
