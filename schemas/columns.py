"""Definitions of all columns, each once: name, type, unit, bounds and meaning."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

from truing.schemas.column import Column, flag, integer, real, share, size, text
from truing.schemas.needs import Need

_CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz", *(f"v{number}" for number in range(1, 9)))

_MEASURED = (
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
    # Loads, readings and positions.
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
    # Quality.
    text("check", "name of the check"),
    real("limit", "", "limit for the verdict, in the unit of its row", nullable=True),
    text("accepted", "person who accepted the verdict, and reason; empty if nobody did", nullable=True),
    text(
        "relation",
        "tested relation between two parts of the campaign: the name of its check. For a cause, the relation that "
        "its search uses: readings-poses, loads-readings, loads-signals, commands-encoders, bodies-survey or "
        "rays-points",
        nullable=True,
    ),
    text("section", "section of the report, or campaign"),
    text("decided_by", "for campaign: the section whose state it takes; empty for a section", nullable=True),
    text(
        "test",
        "tested property of the model's residuals: larger noise of observations or inputs than declared; correlation "
        "between neighbours along a column (like-neighbours), or between neighbouring targets within an epoch "
        "(like-places); a mean over repeated epochs beyond their scatter "
        "(pure-error: the F test of lack of fit), or within a region of the inputs (by-region); a further "
        "significant cause (causes-left)",
        choices=(
            "observation-noise",
            "input-noise",
            "like-neighbours",
            "like-places",
            "pure-error",
            "by-region",
            "causes-left",
        ),
    ),
    text(
        "why_untested",
        "why there is no test: no command was measured twice, or too few epochs",
        nullable=True,
        choices=("no-repeats", "too-few"),
    ),
    text(
        "search_end",
        "why the search for causes stopped: no significant cause is left (complete); eight or more causes were "
        "accepted, and no other one is known to predict held-out epochs better (most-causes), or further fits would "
        "take too long (time); or three unnamed effects were accepted and more is significant (unnamed-effects)",
        nullable=True,
        choices=("complete", "most-causes", "unnamed-effects", "time"),
    ),
    text("left_cause", "cause that would be accepted next; empty if there is none", nullable=True),
    text("left_subject", "subject of left_cause; empty for the whole, or if there is none", nullable=True),
    text(
        "along",
        "column along which neighbours are compared; several columns are separated by blanks; empty for noise and "
        "repeats",
    ),
    text(
        "state",
        "result of the test of a relation or of a model, or of all tests of a section",
        choices=("ok", "attention", "fails", "not tested"),
    ),
    text(
        "reason_code",
        "code of the reason for the state or the verdict. Of a cause: found; noise; remainder (columns predict the "
        "misfit where no model holds); rival; chance; held-out (worse prediction); dropped (not needed next to "
        "others); contained (in a found cause); unseen (the campaign cannot show it); alternative, inadequate, "
        "unnamed, course, not-random, unpaid, elsewhere (suspected: docs/diagnosis.md); ended (search ended without "
        "it); no-time, no-up, ... (a quantity is not recorded). Of a section: docs/verdict.md",
    ),
    real("misfit", "", "rms misfit of the relation as recorded; a count or ratio in unit 1", nullable=True),
    real("misfit_explained", "", "rms misfit with the slips corrected; empty if no slip explains it", nullable=True),
    text("slips", "JSON list of the slips that together explain the data: kind, quantity, subjects, factor"),
    text("rivals", "JSON list of other slips that explain the data equally well"),
    text("hidden_slips", "JSON list of slips that this campaign cannot show"),
    integer("tried", "number of hypotheses tried", minimum=0),
    integer("rows", "number of rows concerned", minimum=0),
    text("by", "rule or person that left the rows out"),
)

_AXES = "xyz"

_PHOTOGRAPHED = (
    text("image", "photograph, by a name that is unique within its pose"),
    text("camera", "camera that took it"),
    text("point", "object point: body/target, else the name from its code; empty if uncoded"),
    text(
        "kind",
        "kind of target",
        choices=("ring8", "ring12", "ring14", "circle", "aruco", "apriltag", "charuco", "chessboard"),
    ),
    *(real(f"{a}_px", "px", f"image coordinate along {a}; the centre of the first pixel is 0") for a in "xy"),
    *(
        real(f"cov_{a}{b}_px2", "px^2", f"covariance of the image coordinates along {a} and {b}")
        for a, b in ("xx", "xy", "yy")
    ),
    size("semi_major_px", "px", "semi-major axis of a circle's image", nullable=True),
    size("semi_minor_px", "px", "semi-minor axis of a circle's image", nullable=True),
    real("axis_angle_rad", "rad", "direction of the major axis, from x towards y", nullable=True),
    size("contrast", "", "edge height of the target over the noise of the image", nullable=True),
    text("file", "file of the photograph; empty if its rays were measured elsewhere", nullable=True),
    integer("width_px", "width of the format in pixels", minimum=1, nullable=True),
    integer("height_px", "height of the format in pixels", minimum=1, nullable=True),
    size("principal_distance_px", "px", "start value from the file; empty: unknown", nullable=True),
    # Files of photographs.
    text("principal_distance_from", "entry of the file that gives the principal distance; empty: none", nullable=True),
    text("taken_at", "time of the camera's clock as ISO 8601; empty: not recorded", nullable=True),
    integer("grey_bits", "bits of a grey value", minimum=1),
    integer("targets_measured", "number of targets measured in it; for a marker or a board, of its corners", minimum=0),
    text("image_remark", "remark about the photograph; empty: none", nullable=True),
    # Cameras.
    flag("free", "whether it is estimated"),
    size("balancing_radius_px", "px", "radius at which the radial distortion is zero by definition; 0: at the centre"),
    size("pixel_um", "um", "pixel pitch", nullable=True),
    real(
        "principal_distance_off_px",
        "px",
        "principal distance of the photograph minus that of most photographs by its camera",
    ),
    size("principal_distance_sigma_px", "px", "standard deviation of principal_distance_off_px"),
    integer(
        "setting",
        "0: as most photographs by its camera; 1, 2, ..: groups that share another principal distance",
        minimum=0,
    ),
    # Prior knowledge.
    text("family", "family of coded targets"),
    text("code", "code within its family"),
    size("diameter_mm", "mm", "diameter of a circular target", nullable=True),
    size("size_mm", "mm", "edge length of a square marker", nullable=True),
    text("bar", "name of the scale bar"),
    text("first", "point at one end"),
    text("second", "point at the other end"),
    text("serves", "whether it defines or checks the scale", choices=("scale", "check")),
    size("length_mm", "mm", "calibrated length"),
    size("sigma_mm", "mm", "standard deviation of the calibrated length, common to all poses"),
    size("repeat_sigma_mm", "mm", "standard deviation of a single distance about the calibrated length"),
    real("expansion_per_k", "1/K", "thermal expansion of the bar", nullable=True),
    real("reference_temperature_c", "degC", "temperature of the calibrated length", minimum=-273.15, nullable=True),
    # Adjusted network.
    integer("rays", "number of rays in the adjustment", minimum=0),
    size("largest_angle_deg", "deg", "largest angle between two rays to the point", nullable=True),
    text("other_point", "other point of the correlation"),
    *(
        real(f"corr_{a}_{b}", "", f"correlation of {a} of the point and {b} of the other", minimum=-1.0, maximum=1.0)
        for a in _AXES
        for b in _AXES
    ),
    *(real(f"effect_{a}_mm", "mm", f"change of {a} for one standard deviation of the common parameter") for a in _AXES),
    *(
        real(f"effect_r{a}_rad", "rad", f"rotation about {a} for one standard deviation of the common parameter")
        for a in _AXES
    ),
    real("effect_um", "um", "change of the shift for one standard deviation of the common parameter"),
    text("measured_number", "number measured in the pose: `platform px` .. `leg6 rz`, `shift 1` .. by leg"),
    real("joint_covariance", "SI", "covariance of the two numbers; units as in cov_0_0 .. cov_5_5"),
    *(real(f"v{a}_px", "px", f"residual along {a}: measured minus adjusted", nullable=True) for a in "xy"),
    *(size(f"sigma_{a}_px", "px", f"standard deviation of {a} used in the adjustment") for a in "xy"),
    *(share(f"redundancy_{a}", f"redundancy number of {a}", nullable=True) for a in "xy"),
    size("test_value", "", "larger of the two standardised residuals", nullable=True),
    *(
        real(f"eccentricity_{a}_px", "px", f"correction subtracted from {a} for the eccentricity of the circle's image")
        for a in "xy"
    ),
    size("rms_px", "px", "root mean square of the residuals of the rays used", nullable=True),
    real("adjusted_mm", "mm", "length between the adjusted points"),
    size("adjusted_sigma_mm", "mm", "standard deviation of adjusted_mm"),
    real("deviation_mm", "mm", "adjusted minus calibrated length"),
    size("deviation_sigma_mm", "mm", "standard deviation of deviation_mm"),
    # Information of rays on shared parameters.
    text("shared_number", "parameter that poses share: its subject and name"),
    text("other_number", "second parameter or number of the pair"),
    text("shared_unit", "unit of the parameter"),
    size("shared_scale", "", "scale unit of the parameter, in its unit"),
    size("shared_sigma", "", "prior standard deviation in the adjustment, in its unit; empty: no prior", nullable=True),
    real("shared_mean", "", "prior value minus adjusted value, in its unit"),
    real("score", "", "derivative of the rays' log likelihood by the parameter at its adjusted value, per scale"),
    real("information", "", "curvature of the log likelihood by the two parameters, per scale of each"),
    *(real(f"moves_{a}_mm", "mm", f"change of {a} per scale of the parameter in this pose alone") for a in _AXES),
)

_FITTED = ("errors-in-variables", "implicit", "nominal", "points")
_DEFORMING = ("none", "linear", "nonlinear", "matrix", "in-plane")
_LOAD_NAMES = ("fx", "fy", "fz", "mx", "my", "mz")
RESULTS = ("pose", "calibration", "accuracy", "cause", "compliance", "G_B", "G_B'", "load", "positioning", "tip")

_CONCLUDED = (
    integer("rank", "1 is the most probable, or the worst", minimum=1),
    text("cause", "id of the cause in the catalogue, or unexplained"),
    text("asked", "key of [diagnosis] that names the cause", choices=("apply", "ignore")),
    text(
        "outcome",
        "outcome of the request; no effect: found, but no calibrated quantity depends on it",
        choices=("applied", "not found", "no effect", "ignored"),
    ),
    text(
        "verdict",
        "result: pass, warn, fail; found, suspected, indistinguishable, rejected, not testable; agrees, differs; "
        "negligible, not negligible",
        nullable=True,
    ),
    share("probability", "probability among the candidates, given the data", nullable=True),
    text("parameters", "JSON: name to value, sigma and unit"),
    text("follows", "for unexplained: the columns on which it depends, separated by blanks", nullable=True),
    *(
        size(
            f"{held}rms_{when}",
            "unit",
            f"rms of measured minus predicted, {when} this cause is accepted",
            nullable=True,
        )
        for held in ("", "heldout_")
        for when in ("before", "after")
    ),
    size(
        "noise_floor",
        "unit",
        "rms expected from the declared noise alone, after the fit of the parameters",
        nullable=True,
    ),
    text("explanation", "what, where, how large, how certain"),
    text("rival", "cause that this campaign does not separate from it", nullable=True),
    text(
        "settings",
        "JSON: fields of the cause as in model.toml, which identify the candidate, and the step of the forward pass "
        "at which it acts",
        nullable=True,
    ),
    text("clause", "physical effect without sizes, as the end of a sentence", nullable=True),
    size("largest_motion", "unit", "largest change of any measured quantity by the effect", nullable=True),
    text(
        "advice_kind",
        "purpose of the next measurement: separate it from its rival; with another kind of measurement; confirm it; "
        "reduce its uncertainty (sharpen); no number of repeats helps (in vain)",
        nullable=True,
        choices=("separate", "another kind", "confirm", "sharpen", "in vain"),
    ),
    text("next_in_short", "next_measurement without settings that a table holds; else empty", nullable=True),
    text("next_purpose", "purpose of its rows in next_poses or next_loads; empty if it has none", nullable=True),
    text("next_measurement", "measurement that confirms it, or separates it from its rivals", nullable=True),
    flag("in_model", "whether the extended model holds the effect; empty in rows on noise or residuals", nullable=True),
    text("determined", "linear combination of the parameters of a cause, with its largest coefficients"),
    text("coefficients", "JSON: coefficient of each parameter in a combination; their squares sum to 1"),
    real("combined_value", "unit", "value of the combination, in the unit of the parameters"),
    size("combined_sigma", "unit", "standard uncertainty of the combination, in the unit of the parameters"),
    share(
        "share_explained",
        "share of a named cause in what it and unnamed effects explain together, in squares; empty without a "
        "competing unnamed effect",
        nullable=True,
    ),
    text(
        "left_out_by",
        "kind of blocks left out in turn to test the cause: the first kind of which two blocks respond to it; "
        "one-block: at most one block responds enough; none: the campaign has no three blocks of any kind",
        nullable=True,
        choices=("series", "run", "day", "direction", "region", "one-block", "none"),
    ),
    integer("left_out_blocks", "number of blocks that respond to the cause", minimum=0, nullable=True),
    real(
        "left_out_gain",
        "",
        "log of the probability ratio of these blocks, with and without the cause, each predicted from the others",
        nullable=True,
    ),
    share(
        "share_predicted",
        "for unexplained effects outside the extended model: share of the plain simulation's misfit that the columns "
        "predict, in squares, minus the share expected by chance",
        nullable=True,
    ),
    size(
        "signal_to_noise",
        "",
        "size of the effect over its noise, without the part that nuisance parameters absorb",
        nullable=True,
    ),
    real("log_evidence", "", "log of the odds against the model without it", nullable=True),
    text(
        "scale_holds",
        "whether its rank holds if plausible scales are tripled",
        nullable=True,
        choices=("holds", "changes"),
    ),
    # Extended model and next measurements.
    size("size", "", "smallest size that is found with probability power", nullable=True),
    share("power", "probability of finding an effect of that size"),
    *(
        real(f"pull_{when}", "", f"shift from nominal over its expected standard deviation, {model}", nullable=True)
        for when, model in (("before", "no effect in the model"), ("after", "found effects in the model"))
    ),
    real("offset_after", "unit", "error of the nominal value if it alone is wrong; empty for a sensor", nullable=True),
    size("explained_after", "", "part of the sum of squared pulls that this error would explain", nullable=True),
    size("chi_square", "", "sum of squared pulls, with their correlations", nullable=True),
    integer("freedom", "number of independent pulls", minimum=0),
    *(
        size(f"largest_{when}", "unit", f"largest of measured minus predicted {when} the extension")
        for when in ("before", "after")
    ),
    text("purpose", "purpose of the measurement: the cause to confirm, or the two to separate"),
    text(
        "need",
        "need for the measurement, the most urgent first: an undecided requirement; rivals to separate; a parameter "
        "to determine better; a cause that this campaign could not show",
        choices=tuple(Need),
    ),
    integer(
        "measurements",
        "total number of further poses or runs for the purpose, with repeats; empty: unknown, or no number is enough",
        minimum=1,
        nullable=True,
    ),
    size(
        "duration_s",
        "s",
        "their duration at the campaign's own pace, without changes of conditions; empty: unknown",
        nullable=True,
    ),
    size(
        "sigma_expected",
        "",
        "expected sigma_now after this and all earlier measurements of the plan, in the unit of its row",
        nullable=True,
    ),
    size(
        "odds_expected",
        "",
        "expected odds of the true rival after this and all earlier measurements of the plan",
        nullable=True,
    ),
    text("expected", "expected result after this and all earlier measurements of the plan", nullable=True),
    text("conditions", "further conditions: approach, pause, pace, surroundings", nullable=True),
    text("channels", "channels to read, separated by blanks"),
    integer("times", "number of repeats; empty: no number is enough", nullable=True),
    real("before", "", "parameter in the earlier campaign, in the unit of its row", nullable=True),
    size("sigma_before", "", "standard deviation of before", nullable=True),
    real("now", "", "parameter by this campaign alone", nullable=True),
    size("sigma_now", "", "standard deviation by this campaign", nullable=True),
    size("sigma_difference", "", "standard deviation of now minus before", nullable=True),
    real("z", "", "now minus before, over its standard deviation", nullable=True),
    real("change", "", "estimated change, if only the parameters marked as changed have changed", nullable=True),
    size("sigma_change", "", "standard deviation of change", nullable=True),
    text("instead", "parameters whose change would explain the data equally well", nullable=True),
    flag("changed", "whether it belongs to the smallest set of parameters whose changes explain all differences"),
    # Comparison of runs.
    integer("place", "position of the run in the order given", minimum=1),
    text("folder", "folder of the run, as given"),
    text("campaign", "campaign of the run; its path, if campaign.toml gives no name"),
    text("group", "kind of number", choices=("geometry", "effect", "compliance", "G_B")),
    real(
        "difference",
        "",
        "the number minus the one that it is compared with: of the previous run, or simulated; in the unit of its row",
        nullable=True,
    ),
    *(
        real(f"missed_{when}", "unit", f"measured minus predicted {when} the extension, in the unit of its row")
        for when in ("before", "after")
    ),
    # Campaigns of one call.
    text("campaign_path", "path of the campaign, as given"),
    integer("exit_code", "exit code of the campaign (docs/running.md)", minimum=0),
    text(
        "campaign_state",
        "state of the campaign's verdict; empty without a verdict",
        nullable=True,
        choices=("ok", "attention", "fails", "not tested"),
    ),
    text("failed_checks", "failed quality checks that nobody accepted, separated by commas", nullable=True),
    integer("problems", "number of faults and other problems that were printed", minimum=0),
    text("problem", "the first of them; empty if there is none", nullable=True),
    text("run_folder", "folder of the run; empty if the campaign did not end", nullable=True),
    integer("stages_run", "number of stages that were not up to date and ran", minimum=0),
    size("processor_s", "s", "processor time of this campaign in this call, in the process that ran it"),
    # Calibration.
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


def by_name(columns: Iterable[Column]) -> dict[str, Column]:
    """Columns by name; raises ValueError for a name that is defined twice."""
    found: dict[str, Column] = {}
    for column in columns:
        if column.name in found:
            raise ValueError(
                f"the column {column.name} is defined twice: {found[column.name].meaning}; {column.meaning}"
            )
        found[column.name] = column
    return found


def find_column(name: str) -> Column | None:
    """Definition of a column by its name, families included, or None."""
    exact = COLUMNS.get(name)
    if exact is not None and not exact.family:
        return exact
    return next((column for column in COLUMNS.values() if column.family and column.matches(name)), None)


COLUMNS = by_name((*_MEASURED, *_PHOTOGRAPHED, *_CONCLUDED))
