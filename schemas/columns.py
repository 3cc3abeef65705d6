"""Every column of every artifact, defined once: its name, type, unit, bounds and meaning."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

from truing.schemas.column import Column, flag, integer, real, share, size, text
from truing.schemas.needs import Need

_CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz", *(f"v{number}" for number in range(1, 9)))

_MEASURED = (
    Column("pose", "identifier", "the pose, as the campaign numbers or names it"),
    text("body", "the rigid body: base, platform, leg1..leg6, or any name without a mechanism"),
    text("parent", "the frame a pose is given in: a body's name, or measurement"),
    text("target", "the target on its body"),
    integer("leg", "the leg, counted from 1; empty where no leg is concerned", minimum=1, nullable=True),
    Column("run", "identifier", "the run of a loading campaign"),
    integer("step", "the load step within its run, in the order taken", minimum=0),
    text("role", "what the pose or run serves", choices=("calibration", "verification", "reference")),
    real("time_s", "s", "when it was taken; orders poses and steps"),
    text("subject", "what a row concerns; empty for the whole", nullable=True),
    text("stage", "the stage that speaks"),
    text("reason", "why it was left out; empty where it was not", nullable=True),
    text(
        "decision",
        "what a person decided, whatever a rule says; empty where nobody did",
        nullable=True,
        choices=("excluded", "kept"),
    ),
    text("message", "one sentence for the engineer"),
    text("status", "how the fit ended; ok, or what prevented it"),
    text("unit", "the unit of the numbers in this row", nullable=True),
    text("model", "the model: of deformation, or of the structure (6-pus, jacobian, beam, stiffness)"),
    text("axis", "the axis of the body frame", choices=("x", "y", "z"), nullable=True),
    text("drive", "the column that the response follows", nullable=True),
    # Of what happened during the campaign, and what persons decided.
    text("called", "what the files call the target"),
    text("from_pose", "the first pose of which it holds; empty: from the first on", nullable=True),
    text("to_pose", "the last pose of which it holds; empty: to the last", nullable=True),
    text("later_survey", "the survey that is compared with those before it"),
    *(
        real(f"shift_{a}_mm", "mm", f"by how much the survey has the target elsewhere along {a}", nullable=True)
        for a in "xyz"
    ),
    size("distance_mm", "mm", "how far it lies from the target's place on the body"),
    text("entry", "which entry of campaign.toml, counted from 1"),
    text("decided_on", "the day of the decision; empty where it was not written down", nullable=True),
    integer("gross_anyway", "rows that would be left out as gross errors by themselves", minimum=0),
    size(
        "largest_change",
        "",
        "by how much the result would be another at most, without the exclusions, in the unit of its row",
        nullable=True,
    ),
    size("over_sigma", "", "that over its standard deviation; of bodies: over that of a target", nullable=True),
    flag("relocated", "whether the target lies elsewhere than before, beyond chance or as was said"),
    text("holds_as", "the target as which the new place holds; empty where it holds for no pose", nullable=True),
    # Of repeats.
    text(
        "repeat_of",
        "the measured pose, or the runs, that this one repeats, by name; empty: it repeats none",
        nullable=True,
    ),
    text("repeated", "what came out again", choices=("pose", "point", "attachment", "reading", "signal")),
    size("pure_error", "", "one standard deviation of a repeat, in the unit of its row"),
    size("declared_sigma", "", "one standard deviation as stated, in the unit of its row", nullable=True),
    size("freedom_of_error", "", "degrees of freedom of the pure error"),
    size("freedom_of_fit", "", "degrees of freedom that the model leaves beside the pure error"),
    integer("groups", "how many poses or programmes of loads were repeated", minimum=1),
    text("told_by", "how repeats are known: repeat_of, the same readings, or the same loads in one order"),
    share(
        "p_equal",
        "probability that repeated groups of one scatter differ as much by chance; small: no one number holds for all",
        nullable=True,
    ),
    integer("attained", "how many times the pose was measured", minimum=2),
    text("contender", "the model that is held against pure error"),
    size("f_ratio", "", "what the model leaves beside pure error over that, per degree of freedom"),
    # Of points.
    *(real(f"{a}_mm", "mm", f"{a} coordinate in the frame of the file") for a in "xyz"),
    *(size(f"sigma_{a}_mm", "mm", f"one standard deviation of {a}", nullable=True) for a in "xyz"),
    *(
        real(
            f"corr_{p}", "", f"correlation of the errors in {p[0]} and {p[1]}", minimum=-1.0, maximum=1.0, nullable=True
        )
        for p in ("xy", "xz", "yz")
    ),
    # Of configurations.
    Column("rho", "real", "actuator reading of that leg, rho0 + delta rho", "mm", family=r"rho[1-9]\d*_mm"),
    real("temperature_c", "degC", "temperature of the mechanism", minimum=-273.15, nullable=True),
    text(
        "event", "what happened before this row: a new text marks the first row after it; empty: nothing", nullable=True
    ),
    text("encoder", "what recorded where an axis stands", choices=("motor", "load", "measured")),
    real("command", "", "where the axis was sent, in command_unit"),
    text("command_unit", "the unit of the axis", choices=("deg", "mm")),
    integer("approach", "direction of approach: -1 or 1", minimum=-1, maximum=1),
    # Of poses.
    text(
        "method",
        "the estimator; measured where the instrument gave the pose itself; model where the extended model predicts",
        choices=("umeyama", "haralick", "maximum_likelihood", "procrustes", "scan", "measured", "model"),
    ),
    flag("default", "whether this row feeds the following stages"),
    *(real(f"p{a}_mm", "mm", f"{a} of the body's origin in the parent frame", nullable=True) for a in "xyz"),
    *(real(f"r{a}_rad", "rad", f"{a} component of the rotation vector, body to parent", nullable=True) for a in "xyz"),
    *(
        real(
            f"cov_{i}_{j}", "SI", "covariance, order p then theta, R <- exp(theta) R in the parent frame", nullable=True
        )
        for i in range(6)
        for j in range(i, 6)
    ),
    size("rms_mm", "mm", "root mean square of the residuals of the targets kept", nullable=True),
    integer("n_used", "targets, points of a scan or readings that entered the fit", minimum=0),
    integer("n_rejected", "targets, points of a scan or readings kept out as gross errors or by a person", minimum=0),
    share("overlap", "share of a scan's points that lie on the reference surface"),
    real("noise_ratio", "", "by which the standard deviations were enlarged for what noise leaves open", minimum=1.0),
    # Of residuals.
    *(real(f"d{a}_mm", "mm", f"measured minus fitted along {a}", nullable=True) for a in "xyz"),
    share("weight", "weight in the fit, 0 (kept out) to 1"),
    flag("rejected", "whether the target was kept out as a gross error or by a person"),
    # Of deformation.
    real("delta_rho_mm", "mm", "actuator displacement from its reference reading"),
    real("delta_bz_um", "um", "shift of the attachment along z of the platform, from its place in the survey"),
    *(real(f"delta_b{a}_um", "um", f"shift of the attachment along {a} of the platform") for a in "xy"),
    *(size(f"sigma_b{a}_um", "um", f"one standard deviation of the shift along {a}") for a in "xy"),
    size("sigma_um", "um", "one standard deviation, all known noise propagated"),
    size("own_sigma_um", "um", "the part of it that the attachment's own targets bring along z"),
    size("scatter_sigma_um", "um", "the part of it that differs from pose to pose, where points have errors in common"),
    real("displacement_um", "um", "shift of a target in its body frame from its place in the survey"),
    flag("significant", "whether it differs from zero at the stated false-alarm rate", nullable=True),
    integer("column", "which drive the coefficient multiplies, counted from 1; 0 is the offset", minimum=0),
    real("coefficient", "", "response per unit of drive, in the unit of its row"),
    size("sigma", "", "one standard deviation of the number beside it", nullable=True),
    share("p_value", "probability of a deviation at least this large by chance", nullable=True),
    text("figure", "the name of the figure"),
    real("value", "", "the number, in the unit of its row", nullable=True),
    # Of loads, readings and positions.
    *(real(f"f{a}_n", "N", f"force along {a} on the platform at its origin", nullable=True) for a in "xyz"),
    *(real(f"m{a}_nm", "N m", f"torque about {a} on the platform", nullable=True) for a in "xyz"),
    *(size(f"sigma_f{a}_n", "N", f"standard deviation of the force along {a}") for a in "xyz"),
    *(size(f"sigma_m{a}_nm", "N m", f"standard deviation of the torque about {a}") for a in "xyz"),
    *(
        real(f"cov_{a}_{b}", "SI", f"covariance of {a} and {b} of a wrench, N and N m")
        for a, b in combinations(("fx", "fy", "fz", "mx", "my", "mz"), 2)
    ),
    flag("is_within", "whether every component lies within 1.05 times the largest load of the calibration"),
    text("response", "component of the response", choices=("dx", "dy", "dz", "rx", "ry", "rz")),
    text("load", "component of the wrench", choices=("fx", "fy", "fz", "mx", "my", "mz")),
    text("channel", "what was read: a motion of the platform, or a signal of the sensor", choices=_CHANNELS),
    real("reading", "", "motion of the platform since the start of the run, in the unit of its row"),
    Column("signal", "real", "signal of that channel of the force sensor", "mV", nullable=True, family=r"v[1-8]_mv"),
    text(
        "sigma_source",
        "what gives the sigma of its readings: a column of samples, or what they leave about their ellipse",
        choices=("column", "ellipse"),
    ),
    integer("samples", "how many samples of the raw signals", minimum=1),
    *(real(f"{a}0", "", f"middle of the ellipse along {a}, in the unit of the signals") for a in "xy"),
    *(size(f"amplitude_{a}", "", f"half axis of the ellipse along {a}") for a in "xy"),
    real("lag_rad", "rad", "by how much the second signal departs from a quarter of a fringe behind the first"),
    size("radius_before", "", "standard deviation of the radius of the signals as they are"),
    size("radius_after", "", "the same once the ellipse of all samples is taken out"),
    size("radius_uncut", "", "the same of the samples that no end of the range cuts, by their ellipse"),
    size("radius_mean", "", "mean radius of the signals"),
    real(
        "geometry", "", "what the declared geometry of its beam adds to a reading; empty where unknown", nullable=True
    ),
    size("geometry_sigma", "", "one sigma of that, in proportion to it", nullable=True),
    text("correction", "what was corrected", choices=("air", "material")),
    real(
        "largest", "", "the largest change, in the unit of its row; empty where readings came corrected", nullable=True
    ),
    share("cut_share", "share of samples at an end of the converter's range"),
    size("periodic_error_um", "um", "largest error of lengths without the ellipse's correction"),
    share("miscount_risk", "largest probability of any step to be counted wrong"),
    real("target_mm", "mm", "where an axis was sent"),
    text("direction", "the side that a target was approached from", choices=("forward", "backward")),
    integer("cycle", "which of the repeated approaches", minimum=1),
    real("position_mm", "mm", "where the axis stood, by the reference"),
    real("position_read_mm", "mm", "where the axis stood as it was read, before it was brought to 20 degC"),
    integer("row_order", "place of the row among those of its table as they were read, from 1", minimum=1),
    real("low", "", "lower end of the interval of 95 %, in the unit of its row", nullable=True),
    real("high", "", "upper end of the interval of 95 %, in the unit of its row", nullable=True),
    integer("case", "the load case: the same loads, reached the same way", minimum=1),
    text(
        "branch",
        "whether the load grew away from zero or came back; several loads at once: the largest in its range",
        choices=("unloaded", "loading", "unloading"),
    ),
    real("applied", "", "load along the axis of its row, N or N m", nullable=True),
    real("measured", "", "what was measured, in the unit of its row"),
    real("simulated", "", "what the simulation gives instead of the number beside it", nullable=True),
    size("simulated_sigma", "", "one standard deviation of it by the tolerances", nullable=True),
    real("residual", "", "measured minus fitted, in the unit of its row", nullable=True),
    text("term", "what a number multiplies"),
    real("air_temperature_c", "degC", "temperature of the air along the beams", minimum=-273.15, nullable=True),
    size("air_pressure_hpa", "hPa", "pressure of the air", nullable=True),
    real("relative_humidity_pct", "%", "humidity of the air", minimum=0.0, maximum=100.0, nullable=True),
    real("material_temperature_c", "degC", "temperature of the platform and its legs", minimum=-273.15, nullable=True),
    # Of quality.
    text("check", "the name of the check"),
    real("limit", "", "the limit that the verdict rests on, in the unit of its row", nullable=True),
    text("accepted", "who accepted the verdict and why; empty where nobody did", nullable=True),
    text(
        "relation",
        "the tested relation between two parts of the campaign: the name of its check; of a cause, what its search "
        "relates: readings-poses, loads-readings, loads-signals, commands-encoders, bodies-survey or rays-points",
        nullable=True,
    ),
    text("section", "the section of the page, or campaign"),
    text("decided_by", "of campaign: the section whose state it takes; empty of a section", nullable=True),
    text(
        "test",
        "what is looked for in what a model leaves: more noise of observations or of inputs than declared, or "
        "residuals that are alike where the values of a column are (like-neighbours), that have a mean where epochs "
        "repeat one another, beyond the scatter of repeats (pure-error: the F test of lack of fit), or in a region of "
        "the inputs, beyond the scatter there (by-region); or a further cause that is real (causes-left)",
        choices=("observation-noise", "input-noise", "like-neighbours", "pure-error", "by-region", "causes-left"),
    ),
    text(
        "why_untested",
        "why nothing was tested: nothing was measured twice at the same command, or too few epochs tell",
        nullable=True,
        choices=("no-repeats", "too-few"),
    ),
    text(
        "search_end",
        "why the search for causes stopped: nothing that is left is real (complete), or it was ended since so many "
        "causes, or effects without a name, were accepted and more is real",
        nullable=True,
        choices=("complete", "most-causes", "unnamed-effects"),
    ),
    text("left_cause", "the cause that would be accepted next; empty where none is left", nullable=True),
    text("left_subject", "what that cause concerns; empty for the whole, and where none is left", nullable=True),
    text(
        "along",
        "the column along which neighbours are compared; several, separated by blanks; empty for noise and repeats",
    ),
    text(
        "state",
        "result of the test of a relation or of a model, or of all tests of a section",
        choices=("ok", "attention", "fails", "not tested"),
    ),
    text(
        "reason_code",
        "code of the reason for the state or the verdict; of a cause: found, noise, remainder (columns that predict "
        "what is missed where no model of causes holds), rival, chance, held-out (predicts "
        "it worse), dropped (not needed next to others), contained (in what was found), unseen (the campaign cannot "
        "show it), or, of one that is suspected, inadequate (the model does not hold as a whole) or unnamed (something "
        "without a name acts as well) or unpaid (the simulation misses by no less with it) or "
        "elsewhere (blocks left out as a whole are less probable with it); ended (the search was ended before it was "
        "accepted or rejected); no-time, no-up, ... (not recorded, so that it could not be tested); of a section: the "
        "list in docs/verdict.md",
    ),
    real("misfit", "", "rms of what the relation leaves as recorded; a count or ratio in unit 1", nullable=True),
    real("misfit_explained", "", "the same with the slips undone; empty where no slip explains it", nullable=True),
    text("slips", "JSON list of the slips that together explain the data: kind, quantity, subjects, factor"),
    text("rivals", "JSON list of slips that explain the data as well as those"),
    text("hidden_slips", "JSON list of slips that this campaign could not show"),
    integer("tried", "number of hypotheses tried", minimum=0),
    integer("rows", "how many rows it concerns", minimum=0),
    text("by", "the rule, or the person, that left them out"),
)

_AXES = "xyz"

_PHOTOGRAPHED = (
    text("image", "the photograph, by a name that is its own within its pose"),
    text("camera", "the camera that took it"),
    text("point", "the object point: body/target, else the name that its code gives it; empty where uncoded"),
    text(
        "kind",
        "the kind of target",
        choices=("ring8", "ring12", "ring14", "circle", "aruco", "apriltag", "charuco", "chessboard"),
    ),
    *(real(f"{a}_px", "px", f"image coordinate along {a}, the middle of the first pixel at 0") for a in "xy"),
    *(
        real(f"cov_{a}{b}_px2", "px^2", f"covariance of the image coordinates along {a} and {b}")
        for a, b in ("xx", "xy", "yy")
    ),
    size("semi_major_px", "px", "semi-major axis of a circle's image", nullable=True),
    size("semi_minor_px", "px", "semi-minor axis of a circle's image", nullable=True),
    real("axis_angle_rad", "rad", "direction of the major axis, from x towards y", nullable=True),
    size("contrast", "", "edge of the target over the noise of the image", nullable=True),
    text("file", "the photograph's file; empty where rays were measured elsewhere", nullable=True),
    integer("width_px", "pixels of the format along x", minimum=1, nullable=True),
    integer("height_px", "pixels of the format along y", minimum=1, nullable=True),
    size("principal_distance_px", "px", "as the file tells it, to start from; empty: unknown", nullable=True),
    # Of the files of photographs.
    text("principal_distance_from", "what in the file tells it; empty: nothing", nullable=True),
    text("taken_at", "when it was taken, by the camera's clock, as ISO 8601; empty: not told", nullable=True),
    integer("grey_bits", "bits of a grey value", minimum=1),
    integer("targets_measured", "targets measured in it; of a marker or a board, its corners", minimum=0),
    text("image_remark", "what is to be known of the photograph; empty: nothing", nullable=True),
    # Of cameras.
    flag("free", "whether it is estimated"),
    size("balancing_radius_px", "px", "where the radial distortion is zero by definition; 0: in the middle"),
    size("pixel_um", "um", "pitch of the pixels", nullable=True),
    real("principal_distance_off_px", "px", "principal distance of one photograph less that of most by its camera"),
    size("principal_distance_sigma_px", "px", "one standard deviation of it"),
    integer("setting", "0: as most photographs by its camera; 1, 2, ..: those that share another", minimum=0),
    # Of what is known beforehand.
    text("family", "the family of coded targets"),
    text("code", "the code within its family"),
    size("diameter_mm", "mm", "diameter of a circular target", nullable=True),
    size("size_mm", "mm", "edge of a square marker", nullable=True),
    text("bar", "the scale bar"),
    text("first", "the point at one end"),
    text("second", "the point at the other end"),
    text("serves", "whether it gives the scale or checks it", choices=("scale", "check")),
    size("length_mm", "mm", "the calibrated length"),
    size("sigma_mm", "mm", "one standard deviation of it, common to all poses"),
    size("repeat_sigma_mm", "mm", "by how much one distance differs from it, one standard deviation"),
    real("expansion_per_k", "1/K", "relative expansion of the bar", nullable=True),
    real("reference_temperature_c", "degC", "temperature of the calibrated length", minimum=-273.15, nullable=True),
    # Of the adjusted network.
    integer("rays", "rays that entered the adjustment", minimum=0),
    size("largest_angle_deg", "deg", "largest angle between two rays to the point", nullable=True),
    text("other_point", "the point that its errors are correlated with"),
    *(
        real(f"corr_{a}_{b}", "", f"correlation of {a} of the point and {b} of the other", minimum=-1.0, maximum=1.0)
        for a in _AXES
        for b in _AXES
    ),
    *(
        real(f"effect_{a}_mm", "mm", f"change of {a} by one standard deviation of the parameter common to all poses")
        for a in _AXES
    ),
    *(
        real(f"effect_r{a}_rad", "rad", f"rotation about {a} by one standard deviation of that parameter")
        for a in _AXES
    ),
    real("effect_um", "um", "change of the shift by one standard deviation of that parameter"),
    text("measured_number", "a number measured in the pose: `platform px` .. `leg6 rz`, `shift 1` .. by leg"),
    real("joint_covariance", "SI", "covariance of the two numbers; of poses as in cov_0_0 .. cov_5_5"),
    *(real(f"v{a}_px", "px", f"residual along {a}: measured minus adjusted", nullable=True) for a in "xy"),
    *(size(f"sigma_{a}_px", "px", f"one standard deviation of {a} that the adjustment took") for a in "xy"),
    *(share(f"redundancy_{a}", f"redundancy number of {a}", nullable=True) for a in "xy"),
    size("test_value", "", "largest of the two standardised residuals", nullable=True),
    *(real(f"eccentricity_{a}_px", "px", f"taken off {a} as the eccentricity of the circle's image") for a in "xy"),
    size("rms_px", "px", "root mean square of the residuals of the rays kept", nullable=True),
    real("adjusted_mm", "mm", "the length that the adjusted points have"),
    size("adjusted_sigma_mm", "mm", "one standard deviation of it"),
    real("deviation_mm", "mm", "adjusted minus calibrated length"),
    size("deviation_sigma_mm", "mm", "one standard deviation of that"),
    # Of what rays say of shared numbers.
    text("shared_number", "a number that poses should share: what it is of, which one, its name"),
    text("other_number", "the number that it is told together with"),
    text("shared_unit", "its unit"),
    size("shared_scale", "", "how much of it counts as one, in its unit"),
    size(
        "shared_sigma", "", "how well the adjustment knew it beforehand, in its unit; empty: not at all", nullable=True
    ),
    real("shared_mean", "", "what was known of it beforehand, less its adjusted value, in its unit"),
    real("score", "", "slope of the log likelihood of the rays by it, at its adjusted value, per scale"),
    real("information", "", "curvature of that by the two numbers, per scale of each"),
    *(real(f"moves_{a}_mm", "mm", f"change of {a} per scale of the number in this pose alone") for a in _AXES),
)

_FITTED = ("errors-in-variables", "implicit", "nominal", "points")
_DEFORMING = ("none", "linear", "nonlinear", "matrix")
_LOAD_NAMES = ("fx", "fy", "fz", "mx", "my", "mz")
RESULTS = ("pose", "calibration", "accuracy", "cause", "compliance", "G_B", "G_B'", "load", "positioning")

_CONCLUDED = (
    integer("rank", "1 is the most probable", minimum=1),
    text("cause", "an id of the catalogue, or unexplained"),
    text("asked", "the key of [diagnosis] that names the cause", choices=("apply", "ignore")),
    text(
        "outcome",
        "what became of it; no effect: found, but nothing that is calibrated depends on it",
        choices=("applied", "not found", "no effect", "ignored"),
    ),
    text(
        "verdict",
        "the finding: pass, warn, fail; found, suspected, indistinguishable, rejected, not testable; agrees, differs",
        nullable=True,
    ),
    share("probability", "among the candidates, given the data", nullable=True),
    text("parameters", "JSON: name to value, sigma and unit"),
    text("follows", "for unexplained: the columns that it follows, separated by blanks", nullable=True),
    *(
        size(f"{held}rms_{when}", "unit", f"rms of measured minus predicted {when} this row is accepted", nullable=True)
        for held in ("", "heldout_")
        for when in ("before", "after")
    ),
    size("noise_floor", "unit", "what the declared noise leaves after the fitted parameters", nullable=True),
    text("explanation", "what, where, how large, how sure"),
    text("rival", "the cause from which this campaign cannot tell it", nullable=True),
    text(
        "settings",
        "JSON: which candidate of its kind it is, by the fields of the cause as in model.toml; and the step of the "
        "chain at which it acts",
        nullable=True,
    ),
    text("clause", "what nature does, without sizes: it completes a sentence", nullable=True),
    size("largest_motion", "unit", "how far the effect moves anything that was measured", nullable=True),
    text(
        "advice_kind",
        "what the next measurement is for: tell it from its rival, or by another kind of measurement; confirm it; know "
        "its size better, or not by any number of repeats",
        nullable=True,
        choices=("separate", "another kind", "confirm", "sharpen", "in vain"),
    ),
    text("next_in_short", "next_measurement without the settings that a table holds; else empty", nullable=True),
    text("next_purpose", "the purpose of its rows in next_poses or next_loads; empty where it has none", nullable=True),
    text("next_measurement", "what to measure to confirm it, or to tell it from its rivals", nullable=True),
    share(
        "share_explained",
        "the share of a named cause in what it and effects without a name explain together, in squares; empty where no "
        "effect without a name competed",
        nullable=True,
    ),
    text(
        "left_out_by",
        "what was left out as a whole, block by block, of what was found: the first kind of which two blocks tell of "
        "the cause; one-block: its effect shows in one alone, or too little in each; none: the campaign has no three "
        "blocks of any kind",
        nullable=True,
        choices=("series", "run", "day", "direction", "region", "one-block", "none"),
    ),
    integer("left_out_blocks", "number of blocks that tell of the cause", minimum=0, nullable=True),
    real(
        "left_out_gain",
        "",
        "logarithm of how much more probable these blocks are with the cause than without it, each predicted from the "
        "others",
        nullable=True,
    ),
    share(
        "share_predicted",
        "for unexplained where no model of causes holds: the share of what the plain simulation misses there that the "
        "columns predict, in squares, less what chance predicts",
        nullable=True,
    ),
    size("signal_to_noise", "", "the effect over its noise, all nuisances taken out of it", nullable=True),
    real("log_evidence", "", "logarithm of the odds against the model without it", nullable=True),
    text(
        "scale_holds",
        "whether its place in the ranking stays when plausible scales are tripled",
        nullable=True,
        choices=("holds", "changes"),
    ),
    # Of the extended model, and what to measure next.
    size("size", "", "the smallest size that is found with the probability beside it", nullable=True),
    share("power", "the probability of being found at that size"),
    *(
        real(f"pull_{when}", "", f"shift over what the data let it differ by, {model}", nullable=True)
        for when, model in (("before", "no effect in the model"), ("after", "found effects in the model"))
    ),
    size("chi_square", "", "the pulls together, their correlations taken into account", nullable=True),
    integer("freedom", "how many independent pulls there are", minimum=0),
    *(
        size(f"largest_{when}", "unit", f"largest of measured minus predicted {when} the extension")
        for when in ("before", "after")
    ),
    text("purpose", "what a measurement is for: the cause to confirm, or the two to tell apart"),
    text(
        "need",
        "what the measurement serves, the most urgent first: a requirement that is undecided; to tell rivals apart, "
        "named or not; a parameter that is to be known better; a cause that this campaign could not show",
        choices=tuple(Need),
    ),
    integer(
        "measurements",
        "further poses or runs that the purpose takes in all, with repeats; empty: not known, or none is enough",
        minimum=1,
        nullable=True,
    ),
    size(
        "duration_s",
        "s",
        "how long they take at the campaign's own pace, without changes of conditions; empty: not known",
        nullable=True,
    ),
    size(
        "sigma_expected",
        "",
        "the same once this and those before it are measured, in the unit of its row",
        nullable=True,
    ),
    size(
        "odds_expected",
        "",
        "odds of the rival that is right, once this and those before it are measured",
        nullable=True,
    ),
    text("expected", "what is expected once this and those before it are measured", nullable=True),
    text("conditions", "what else to see to: approach, pause, pace, surroundings", nullable=True),
    text("channels", "what is read, separated by blanks"),
    integer("times", "how often it is to be measured; empty: no number of times is enough", nullable=True),
    real("before", "", "the parameter as the earlier campaign left it, in the unit of its row", nullable=True),
    size("sigma_before", "", "one standard deviation of it then", nullable=True),
    real("now", "", "the parameter as this campaign alone has it", nullable=True),
    size("sigma_now", "", "one standard deviation of it now", nullable=True),
    size("sigma_difference", "", "one standard deviation of now minus before", nullable=True),
    real("z", "", "now minus before, over its standard deviation", nullable=True),
    real("change", "", "by how much it changed, were the changed ones the only ones", nullable=True),
    size("sigma_change", "", "one standard deviation of that", nullable=True),
    text("instead", "numbers whose change in its place would explain as much", nullable=True),
    flag("changed", "whether it is among the fewest numbers whose changes explain all differences"),
    # Of runs side by side.
    integer("place", "the run's place in the order in which the runs were named", minimum=1),
    text("folder", "the run's folder, as it was named"),
    text("campaign", "the campaign that the run is of"),
    text("group", "what the number is of", choices=("geometry", "effect", "compliance", "G_B")),
    real("difference", "", "the number minus that of the run before, in the unit of its row", nullable=True),
    *(
        real(f"missed_{when}", "unit", f"measured minus predicted {when} the extension, in the unit of its row")
        for when in ("before", "after")
    ),
    # Of calibration.
    text("deformation", "how the platform deforms in the model", choices=_DEFORMING),
    text("parameter", "the parameter: a_x, b_y, u_x, l, rho0, kappa, K12, ..."),
    real("nominal", "", "the parameter before calibration, in the unit of its row", nullable=True),
    real("identified", "", "the parameter after calibration", nullable=True),
    size("tolerance", "", "one standard deviation of manufacturing and assembly", nullable=True),
    real("pull", "", "difference from nominal over what tolerance and measurement let it differ by", nullable=True),
    flag("identifiable", "whether the data tell the parameter better than its tolerance does"),
    text("effect_of", "the cause and its subject; empty for the machine's own numbers", nullable=True),
    integer("other_leg", "the leg of the other parameter, counted from 1", minimum=1, nullable=True),
    text("other_parameter", "the other parameter of a pair"),
    real("correlation", "", "correlation of the two errors", minimum=-1.0, maximum=1.0),
    size("position_error_um", "um", "distance between measured and predicted platform origin"),
    size("orientation_error_arcsec", "arcsec", "angle between measured and predicted platform"),
    *(real(f"d{a}_um", "um", f"measured minus predicted along {a} of the base", nullable=True) for a in "xyz"),
    *(real(f"r{a}_arcsec", "arcsec", f"measured minus predicted about {a} of the base", nullable=True) for a in "xyz"),
    size("position_noise_um", "um", "rms position error that noise alone would leave", nullable=True),
    size("orientation_noise_arcsec", "arcsec", "rms orientation error that noise alone would leave", nullable=True),
    text("estimator", "how it was fitted", choices=_FITTED),
    text("combination", "parameters that cannot be told apart, in words", nullable=True),
    text("effect", "the effect that was left out of the model"),
    real("predicted", "", "how much of the effect the parameter takes, by linear algebra before the fit"),
    real("observed", "", "how much the parameter moved when the effect was left out of the fit", nullable=True),
    # Of a force sensor.
    text("matrix", "which matrix", choices=("G", "G'", "G_B", "G_B'", "terms")),
    text("row", "the row of a matrix: a component of the wrench, or a signal"),
    text("column_name", "the column of a matrix: a leg, a signal, or a term"),
    size("sigma_by_case", "", "one standard deviation by leaving load cases out in turn", nullable=True),
    flag("chosen", "whether held-out loads speak for it"),
    size("length_m", "m", "over which moments are counted; 1 m leaves them as they are", nullable=True),
    text("error_class", "the error, by the name that laboratories give it"),
    text("indicated", "the component that indicated it", choices=_LOAD_NAMES),
    # Of calibrations held against each other, and against a second campaign.
    text("data", "what is calibrated", choices=("as recorded", "with findings")),
    flag("is_main", "whether the other tables tell of this calibration"),
    text("findings", "the causes whose effects it holds, with their subjects; empty: none", nullable=True),
    text(
        "tested_on",
        "what the errors are of; held-out load cases are predicted by a fit to all others",
        choices=("verification poses", "calibration poses", "held-out load cases", "verification runs"),
    ),
    size("rms_error", "", "root mean square of measured minus predicted, in the unit of its row"),
    size("largest_error", "", "the largest of them in size", nullable=True),
    size(
        "rms_unchanged",
        "",
        "their root mean square over what no finding changes, which is the same in both; empty where a finding changes "
        "everything",
        nullable=True,
    ),
    text(
        "prediction_by",
        "what predicts: the machine as drawn, the chosen calibration, or the extended model of the diagnosis",
        choices=("nominal", "calibrated", "extended"),
    ),
    size("noise_rms", "", "root mean square that noise alone would leave", nullable=True),
    integer("count", "how many poses, load steps or readings it is the root mean square of", minimum=1),
    # Of requirements.
    text("component", "position along or rotation about an axis", choices=("x", "y", "z", "rx", "ry", "rz")),
    real("requirement", "", "the accuracy asked for, in the unit of its row", nullable=True),
    size("error", "", "the error that 95 of 100 poses stay below", nullable=True),
    size("lower", "", "lower end of the 95 % interval of the number beside it", nullable=True),
    size("upper", "", "upper end of the 95 % interval of the number beside it", nullable=True),
    integer("poses_judged", "poses that an undecided requirement rests on; else empty", minimum=1, nullable=True),
    *(
        size(f"{end}_expected", "", f"{end} end of that interval once these poses are measured", nullable=True)
        for end in ("lower", "upper")
    ),
    # Of uncertainty.
    text("result", "what kind of result", choices=RESULTS),
    text("quantity", "which number of the subject"),
    real("estimate", "", "the value that is stated, in the unit of its row", nullable=True),
    size("standard_uncertainty", "", "combined standard uncertainty of the estimate", nullable=True),
    size(
        "degrees_of_freedom",
        "",
        "of the uncertainty beside it (combined: by Welch and Satterthwaite); empty: without bound",
        nullable=True,
    ),
    size("coverage_factor", "", "by which the standard uncertainty is multiplied", nullable=True),
    size("expanded_uncertainty", "", "half the interval of 95 %", nullable=True),
    flag("stated", "whether an uncertainty is stated; else the reason says why not"),
    text("input_source", "the source of uncertainty"),
    text(
        "evaluation",
        "A: from observations of this campaign; B: declared; or not evaluated, and so no part of the budget",
        choices=("A", "B", "not evaluated"),
    ),
    text("distribution", "the distribution that the source is taken to have", nullable=True),
    size("contribution", "", "standard uncertainty that the source gives to the result", nullable=True),
    share("share_of_variance", "its share in the squared uncertainty", nullable=True),
)


def by_name(columns: Iterable[Column]) -> dict[str, Column]:
    """Columns by their names; raises ValueError where a name is defined twice, for one would override the other."""
    found: dict[str, Column] = {}
    for column in columns:
        if column.name in found:
            raise ValueError(
                f"the column {column.name} is defined twice: {found[column.name].meaning}; {column.meaning}"
            )
        found[column.name] = column
    return found


def find_column(name: str) -> Column | None:
    """The definition that covers a column's name, families included, or None."""
    exact = COLUMNS.get(name)
    if exact is not None and not exact.family:
        return exact
    return next((column for column in COLUMNS.values() if column.family and column.matches(name)), None)


COLUMNS = by_name((*_MEASURED, *_PHOTOGRAPHED, *_CONCLUDED))
