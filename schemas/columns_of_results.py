"""Columns of what is concluded: diagnosis, comparison, calibration, requirements, uncertainty."""

from __future__ import annotations

from truing.schemas.column import Column, real

DIAGNOSIS = (
    Column("rank", "integer", "1 is the most probable", minimum=1),
    Column("cause", "text", "an id of the catalogue, or unexplained"),
    Column(
        "verdict",
        "text",
        "the finding: pass, warn, fail; found, indistinguishable, rejected; or agrees, differs",
        nullable=True,
    ),
    real("probability", "", "among the candidates, given the data", minimum=0.0, maximum=1.0, nullable=True),
    Column("parameters", "text", "JSON: name to value, sigma and unit"),
    Column("follows", "text", "for unexplained: the columns that it follows, separated by blanks", nullable=True),
    *(
        real(
            f"{held}rms_{when}",
            "unit",
            f"rms of measured minus predicted {when} this row is accepted",
            minimum=0.0,
            nullable=True,
        )
        for held in ("", "heldout_")
        for when in ("before", "after")
    ),
    real(
        "noise_floor", "unit", "what the declared noise leaves after the fitted parameters", minimum=0.0, nullable=True
    ),
    Column("explanation", "text", "what, where, how large, how sure"),
    Column("rival", "text", "the cause from which this campaign cannot tell it", nullable=True),
    Column(
        "settings",
        "text",
        "JSON: which candidate of its kind it is, by the fields of the cause as in model.toml; and the step of the "
        "chain at which it acts",
        nullable=True,
    ),
    Column("clause", "text", "what nature does, without sizes: it completes a sentence", nullable=True),
    real("largest_motion", "unit", "how far the effect moves anything that was measured", minimum=0.0, nullable=True),
    Column(
        "advice_kind",
        "text",
        "what the next measurement is for: tell it from its rival, or by another kind of measurement; confirm it; know "
        "its size better, or not by any number of repeats",
        nullable=True,
        choices=("separate", "another kind", "confirm", "sharpen", "in vain"),
    ),
    Column(
        "next_in_short", "text", "next_measurement without the settings that a table holds; else empty", nullable=True
    ),
    Column("next_measurement", "text", "what to measure to confirm it, or to tell it from its rivals", nullable=True),
    real("signal_to_noise", "", "the effect over its noise, all nuisances taken out of it", minimum=0.0, nullable=True),
    real("log_evidence", "", "logarithm of the odds against the model without it", nullable=True),
    Column(
        "scale_holds",
        "text",
        "whether its place in the ranking stays when plausible scales are tripled",
        nullable=True,
        choices=("holds", "changes"),
    ),
)

EXTENSION = (
    real("size", "", "the smallest size that is found with the probability beside it", minimum=0.0, nullable=True),
    real("power", "", "the probability of being found at that size", minimum=0.0, maximum=1.0),
    *(
        real(f"pull_{when}", "", f"shift over what the data let it differ by, {model}", nullable=True)
        for when, model in (("before", "no effect in the model"), ("after", "found effects in the model"))
    ),
    real("chi_square", "", "the pulls together, their correlations taken into account", minimum=0.0, nullable=True),
    Column("freedom", "integer", "how many independent pulls there are", minimum=0),
    *(
        real(f"largest_{when}", "unit", f"largest of measured minus predicted {when} the extension", minimum=0.0)
        for when in ("before", "after")
    ),
    Column("purpose", "text", "what a measurement is for: the cause to confirm, or the two to tell apart"),
    Column("expected", "text", "what is expected once this and those before it are measured", nullable=True),
    Column("conditions", "text", "what else to see to: approach, pause, pace, surroundings", nullable=True),
    Column("channels", "text", "what is read, separated by blanks"),
    Column("times", "integer", "how often all of them are needed; empty: no number is enough", nullable=True),
    real("before", "", "the parameter as the earlier campaign left it, in the unit of its row", nullable=True),
    real("sigma_before", "", "one standard deviation of it then", minimum=0.0, nullable=True),
    real("now", "", "the parameter as this campaign alone has it", nullable=True),
    real("sigma_now", "", "one standard deviation of it now", minimum=0.0, nullable=True),
    real("sigma_difference", "", "one standard deviation of now minus before", minimum=0.0, nullable=True),
    real("z", "", "now minus before, over its standard deviation", nullable=True),
    real("change", "", "by how much it changed, were the changed ones the only ones", nullable=True),
    real("sigma_change", "", "one standard deviation of that", minimum=0.0, nullable=True),
    Column("instead", "text", "numbers whose change in its place would explain as much", nullable=True),
    Column("changed", "flag", "whether it is among the fewest numbers whose changes explain all differences"),
)

COMPARED = (
    Column("place", "integer", "the run's place in the order in which the runs were named", minimum=1),
    Column("folder", "text", "the run's folder, as it was named"),
    Column("campaign", "text", "the campaign that the run is of"),
    Column("group", "text", "what the number is of", choices=("geometry", "effect", "compliance", "G_B")),
    real("difference", "", "the number minus that of the run before, in the unit of its row", nullable=True),
)

READING_ERRORS = tuple(
    real(f"missed_{when}", "unit", f"measured minus predicted {when} the extension, in the unit of its row")
    for when in ("before", "after")
)

_FITTED = ("errors-in-variables", "implicit", "nominal", "points")
_DEFORMING = ("none", "linear", "nonlinear", "matrix")

CALIBRATION = (
    Column("deformation", "text", "how the platform deforms in the model", choices=_DEFORMING),
    Column("parameter", "text", "the parameter: a_x, b_y, u_x, l, rho0, kappa, K12, ..."),
    real("nominal", "", "the parameter before calibration, in the unit of its row", nullable=True),
    real("identified", "", "the parameter after calibration", nullable=True),
    real("tolerance", "", "one standard deviation of manufacturing and assembly", minimum=0.0, nullable=True),
    real("pull", "", "difference from nominal over what tolerance and measurement let it differ by", nullable=True),
    Column("identifiable", "flag", "whether the data tell the parameter better than its tolerance does"),
    Column("effect_of", "text", "the cause and its subject; empty for the machine's own numbers", nullable=True),
    Column("other_leg", "integer", "the leg of the other parameter, counted from 1", minimum=1, nullable=True),
    Column("other_parameter", "text", "the other parameter of a pair"),
    real("correlation", "", "correlation of the two errors", minimum=-1.0, maximum=1.0),
    real("position_error_um", "um", "distance between measured and predicted platform origin", minimum=0.0),
    real("orientation_error_arcsec", "arcsec", "angle between measured and predicted platform", minimum=0.0),
    *(real(f"d{a}_um", "um", f"measured minus predicted along {a} of the base", nullable=True) for a in "xyz"),
    *(real(f"r{a}_arcsec", "arcsec", f"measured minus predicted about {a} of the base", nullable=True) for a in "xyz"),
    real("position_noise_um", "um", "rms position error that noise alone would leave", minimum=0.0, nullable=True),
    real(
        "orientation_noise_arcsec",
        "arcsec",
        "rms orientation error that noise alone would leave",
        minimum=0.0,
        nullable=True,
    ),
    Column("estimator", "text", "how it was fitted", choices=_FITTED),
    Column("combination", "text", "parameters that cannot be told apart, in words", nullable=True),
    Column("effect", "text", "the effect that was left out of the model"),
    real("predicted", "", "how much of the effect the parameter takes, by linear algebra before the fit"),
    real("observed", "", "how much the parameter moved when the effect was left out of the fit", nullable=True),
)

_LOAD_NAMES = ("fx", "fy", "fz", "mx", "my", "mz")

SENSOR = (
    Column("matrix", "text", "which matrix", choices=("G", "G'", "G_B", "G_B'", "terms")),
    Column("row", "text", "the row of a matrix: a component of the wrench, or a signal"),
    Column("column_name", "text", "the column of a matrix: a leg, a signal, or a term"),
    real("sigma_by_case", "", "one standard deviation by leaving load cases out in turn", minimum=0.0, nullable=True),
    Column("chosen", "flag", "whether held-out loads speak for it"),
    real("length_m", "m", "over which moments are counted; 1 m leaves them as they are", minimum=0.0, nullable=True),
    Column("error_class", "text", "the error, by the name that laboratories give it"),
    Column("indicated", "text", "the component that indicated it", choices=_LOAD_NAMES),
)

REQUIREMENTS = (
    Column("component", "text", "position along or rotation about an axis", choices=("x", "y", "z", "rx", "ry", "rz")),
    real("requirement", "", "the accuracy asked for, in the unit of its row", nullable=True),
    real("error", "", "the error that 95 of 100 poses stay below", minimum=0.0, nullable=True),
    real("lower", "", "lower end of the 95 % interval of the number beside it", minimum=0.0, nullable=True),
    real("upper", "", "upper end of the 95 % interval of the number beside it", minimum=0.0, nullable=True),
)

RESULTS = ("pose", "calibration", "accuracy", "cause", "compliance", "G_B", "load", "positioning")
UNCERTAINTY = (
    Column("result", "text", "what kind of result", choices=RESULTS),
    Column("quantity", "text", "which number of the subject"),
    real("estimate", "", "the value that is stated, in the unit of its row", nullable=True),
    real("standard_uncertainty", "", "combined standard uncertainty of the estimate", minimum=0.0, nullable=True),
    real(
        "degrees_of_freedom",
        "",
        "of the uncertainty beside it (combined: by Welch and Satterthwaite); empty: without bound",
        minimum=0.0,
        nullable=True,
    ),
    real("coverage_factor", "", "by which the standard uncertainty is multiplied", minimum=0.0, nullable=True),
    real("expanded_uncertainty", "", "half the interval of 95 %", minimum=0.0, nullable=True),
    Column("stated", "flag", "whether an uncertainty is stated; else the reason says why not"),
    Column("input_source", "text", "the source of uncertainty"),
    Column(
        "evaluation",
        "text",
        "A: from observations of this campaign; B: declared; or not evaluated, and so no part of the budget",
        choices=("A", "B", "not evaluated"),
    ),
    Column("distribution", "text", "the distribution that the source is taken to have", nullable=True),
    real("contribution", "", "standard uncertainty that the source gives to the result", minimum=0.0, nullable=True),
    real("share_of_variance", "", "its share in the squared uncertainty", minimum=0.0, maximum=1.0, nullable=True),
)
