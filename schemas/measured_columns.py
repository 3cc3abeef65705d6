"""Columns of points, poses, residuals and deformation, and those that most tables share."""

from __future__ import annotations

from truing.schemas.column import Column, flag, integer, real, share, size, text

MEASURED_COLUMNS = (
    Column("pose", "identifier", "number or name of the pose in the campaign"),
    text("body", "rigid body: base, platform or leg1..leg6 of a mechanism, link of a chain, or any other name"),
    text("parent", "frame in which the pose is given: name of a body, or measurement"),
    text("target", "name of the target on its body"),
    integer("leg", "leg, counted from 1; empty if the row concerns no leg", minimum=1, nullable=True),
    Column("run", "identifier", "run of a loading campaign"),
    integer("step", "load step within its run, in the order taken", minimum=0),
    text(
        "role",
        "use of the pose or run: fitted (calibration), held out (verification) or reference",
        choices=("calibration", "verification", "reference"),
    ),
    real("time_s", "s", "time of the measurement; orders poses and steps"),
    text("subject", "what the row concerns; empty for the whole", nullable=True),
    text("stage", "stage that wrote the row"),
    text("reason", "reason for leaving it out; empty if it is used", nullable=True),
    integer(
        "measured_there",
        "number of values measured at the pose or load step; empty for a point left out before the model was fitted",
        minimum=1,
        nullable=True,
    ),
    text(
        "kept_because",
        "predicted: nonlinear terms of the loads, fitted to other load steps, predict it; shared input: several of its "
        "channel deviate alike where they share an input",
        choices=("predicted", "shared input"),
    ),
    text("shared_input", "terms of the loads that predict it, or the loads or the run that have it in common"),
    text(
        "decision",
        "decision of a person, which overrides all rules; empty if there is none",
        nullable=True,
        choices=("excluded", "kept"),
    ),
    text("message", "one sentence that explains the result"),
    text("status", "end of the fit: ok, or the reason of its failure"),
    text("unit", "unit of the numbers in this row", nullable=True),
    text("model", "model of deformation, or of the structure (6-pus, jacobian, beam, stiffness)"),
    text("axis", "axis of the body frame", choices=("x", "y", "z"), nullable=True),
    text("drive", "column on which the response depends", nullable=True),
    # Open chains.
    text("from_link", "link of the first end; empty for a station", nullable=True),
    text("from_end", "first end of the distance: a target, or station:NAME"),
    text("to_link", "link of the second end; empty for a station", nullable=True),
    text("to_end", "second end of the distance: a target, or station:NAME"),
    size("reading_mm", "mm", "distance that was read"),
    integer("node", "number of the joint and its link in the chain; 0 is the base", minimum=0),
    text("joint", "joint; empty for the base, a fixed end, or a row that concerns no joint", nullable=True),
    text("link", "link that the joint moves, or the link concerned", nullable=True),
    integer("below", "node that carries this one; -1 for the base", minimum=-1),
    text("joint_kind", "motion of the joint", choices=("fixed", "revolute", "prismatic")),
    *(real(f"axis_{a}", "", f"component of the joint's axis along {a}, in the joint's frame") for a in "xyz"),
    integer("combination_number", "number of the combination", minimum=1),
    text(
        "number_kind",
        "what a number of a chain describes",
        choices=("base", "link", "offset", "target", "cause"),
    ),
    real("number_change", "", "change of the number within the combination, in the unit of its row"),
    text(
        "remedy",
        "what would separate the combination: other poses, another payload, targets of known place on the base, known "
        "places of the targets, or none of these",
        choices=("poses", "payload", "base-targets", "target-places", "none"),
    ),
    text("separating_pose", "readings of a pose that would separate the combination, by column", nullable=True),
    text("closure", "closure of the chain's loops, of an installed package; empty for an open chain", nullable=True),
    text("follows_joint", "joint whose reading moves this one; empty for a fixed joint", nullable=True),
    real("factor", "", "motion of the joint per unit of the reading"),
    real("zero_si", "", "motion of the joint where the reading is zero, rad or m"),
    size("mass_kg", "kg", "mass of the link; 0 if unknown"),
    *(real(f"com_{a}_mm", "mm", f"centre of the link's mass along {a}, in the link's frame") for a in "xyz"),
    real("lower_si", "", "lower limit of the joint, rad or m; empty if unknown", nullable=True),
    real("upper_si", "", "upper limit of the joint, rad or m; empty if unknown", nullable=True),
    real("joint_reading_si", "", "reading of the joint, rad or m"),
    real("deviation_si", "", "motion of the joint minus its reading, rad or m"),
    text(
        "guideway_motion",
        "motion of the carriage along or about one axis of the joint's frame",
        choices=("shift", "turn"),
    ),
    text("guideway_axis", "axis of the joint's frame", choices=("x", "y", "z")),
    real("guideway_error_si", "", "error of the guideway, m or rad"),
    size("guideway_sigma_si", "", "standard deviation of the error of the guideway, m or rad"),
    real("measured_from_si", "", "lowest measured reading of the joint, m"),
    real("measured_to_si", "", "highest measured reading of the joint, m"),
    size("deviation_sigma_si", "", "standard deviation of the motion minus the reading, rad or m"),
    flag("is_determined", "whether the data reduce the standard deviation below half of that known before"),
    integer("input", "number of the joint among those that are read; -1 for the others", minimum=-1),
    integer("poses", "number of poses", minimum=1),
    text("series", "part of the campaign, where several were measured; empty: none", nullable=True),
    # Events and decisions of persons.
    text("called", "name of the target in the files"),
    text("from_pose", "first pose for which it holds; empty: from the first pose on", nullable=True),
    text("to_pose", "last pose for which it holds; empty: to the last pose", nullable=True),
    text("later_survey", "survey that is compared with the earlier ones"),
    *(
        real(
            f"shift_{a}_mm",
            "mm",
            f"position of the target along {a} in this survey minus the earlier one",
            nullable=True,
        )
        for a in "xyz"
    ),
    size("distance_mm", "mm", "distance from the target's position on the body"),
    text("entry", "number of the entry in campaign.toml, from 1"),
    text("decided_on", "day of the decision; empty if not recorded", nullable=True),
    integer("gross_anyway", "rows that are gross errors even without the exclusion", minimum=0),
    size(
        "largest_change",
        "",
        "largest change of the result without the exclusions, in the unit of its row",
        nullable=True,
    ),
    size(
        "over_sigma",
        "",
        "largest_change over its standard deviation; for bodies, over the standard deviation of a target",
        nullable=True,
    ),
    flag("relocated", "whether the target moved, significantly or as declared"),
    text("holds_as", "target name for the new position; empty if no pose uses it", nullable=True),
    # Repeats.
    text(
        "repeat_of",
        "names of the measured pose, or of the runs, that this one repeats; empty: none",
        nullable=True,
    ),
    text("repeated", "repeated quantity", choices=("pose", "point", "attachment", "reading", "signal")),
    size("pure_error", "", "standard deviation between repeats, in the unit of its row"),
    size("declared_sigma", "", "declared standard deviation, in the unit of its row", nullable=True),
    size("freedom_of_error", "", "degrees of freedom of the pure error"),
    size("freedom_of_fit", "", "degrees of freedom of the model's residuals beyond the pure error"),
    integer("groups", "number of repeated poses or load programmes", minimum=1),
    text("told_by", "how repeats are recognised: repeat_of, equal readings, or equal loads in one order"),
    share(
        "p_equal",
        "probability of as large differences in scatter between groups, if all have the same scatter; small: one "
        "number does not hold for all",
        nullable=True,
    ),
    integer("attained", "number of measurements of the pose", minimum=2),
    text("other_pose", "other pose of a distance; empty: the figure is of one pose", nullable=True),
    text("contender", "model that is tested against pure error"),
    size("f_ratio", "", "mean square of the model's residuals beyond pure error, over that of pure error"),
    # Points.
    *(real(f"{a}_mm", "mm", f"{a} coordinate in the frame of the file") for a in "xyz"),
    *(size(f"sigma_{a}_mm", "mm", f"one standard deviation of {a}", nullable=True) for a in "xyz"),
    *(
        real(
            f"corr_{p}", "", f"correlation of the errors in {p[0]} and {p[1]}", minimum=-1.0, maximum=1.0, nullable=True
        )
        for p in ("xy", "xz", "yz")
    ),
    # Configurations.
    Column("rho", "real", "actuator reading of that leg, rho0 + delta rho", "mm", family=r"rho[1-9]\d*_mm"),
    real("temperature_c", "degC", "temperature of the mechanism", minimum=-273.15, nullable=True),
    text("event", "event before this row: a new text marks the first row after it; empty: nothing", nullable=True),
    text(
        "encoder", "encoder or instrument that recorded the position of the axis", choices=("motor", "load", "measured")
    ),
    real("command", "", "commanded position of the axis, in command_unit"),
    text("command_unit", "unit of the axis", choices=("deg", "mm")),
    integer("approach", "direction of approach: -1 or 1", minimum=-1, maximum=1),
    # Poses.
    text(
        "method",
        "estimator; measured: reported by the instrument; model: predicted by the extended model",
        choices=("umeyama", "haralick", "maximum_likelihood", "procrustes", "scan", "measured", "model"),
    ),
    flag("default", "whether later stages use this row"),
    *(real(f"p{a}_mm", "mm", f"{a} of the body's origin in the parent frame", nullable=True) for a in "xyz"),
    *(real(f"r{a}_rad", "rad", f"{a} component of the rotation vector, body to parent", nullable=True) for a in "xyz"),
    *(
        real(f"recorded_{a}_rad", "rad", f"number {k} of recorded Euler angles or rotation vectors", nullable=True)
        for k, a in enumerate("abc", 1)
    ),
    *(
        real(
            f"cov_{i}_{j}", "SI", "covariance, order p then theta, R <- exp(theta) R in the parent frame", nullable=True
        )
        for i in range(6)
        for j in range(i, 6)
    ),
    size("rms_mm", "mm", "root mean square of the residuals of the targets used", nullable=True),
    integer("n_used", "number of targets, points of a scan or readings in the fit", minimum=0),
    integer(
        "n_rejected",
        "number of targets, points of a scan or readings rejected as gross errors or by a person",
        minimum=0,
    ),
    share("overlap", "share of a scan's points on the reference surface"),
    real("noise_ratio", "", "factor on the standard deviations, because the noise is uncertain", minimum=1.0),
    # Residuals.
    *(real(f"d{a}_mm", "mm", f"measured minus fitted along {a}", nullable=True) for a in "xyz"),
    share("weight", "weight in the fit, from 0 (rejected) to 1"),
    flag("rejected", "whether it was rejected as a gross error or by a person"),
    # Deformation.
    real("delta_rho_mm", "mm", "actuator displacement from its reference reading"),
    real("delta_bz_um", "um", "shift of the attachment along z of the platform, from its surveyed position"),
    *(real(f"delta_b{a}_um", "um", f"shift of the attachment along {a} of the platform") for a in "xy"),
    *(size(f"sigma_b{a}_um", "um", f"one standard deviation of the shift along {a}") for a in "xy"),
    size("sigma_um", "um", "standard deviation with all known noise"),
    size("own_sigma_um", "um", "part of the standard deviation along z from the attachment's own targets"),
    size(
        "scatter_sigma_um",
        "um",
        "part of the standard deviation that differs from pose to pose, if points have common errors",
    ),
    real("displacement_um", "um", "shift of a target in its body frame, from its surveyed position"),
    flag("significant", "whether it differs from zero at the stated false-alarm rate", nullable=True),
    integer("column", "number of the drive that the coefficient multiplies, from 1; 0 is the offset", minimum=0),
    real("coefficient", "", "response per unit of drive, in the unit of its row"),
    size("sigma", "", "standard deviation of the number in this row", nullable=True),
    share("p_value", "probability of a deviation at least this large by chance", nullable=True),
    text("figure", "name of the figure"),
    real("value", "", "value, in the unit of its row", nullable=True),
)
