"""Every column of every artifact, defined once: name, type, unit, bounds, meaning."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

# No measurement, in whatever unit; its fourth power is still a number, so that nothing later overflows.
LARGEST = 1e30

Kind = Literal["identifier", "text", "integer", "real", "flag"]


@dataclass(frozen=True)
class Column:
    """One named quantity; the same name means the same thing in every table.

    ``identifier`` columns are int64 where every value of the campaign is an integer, else text. ``family`` is a
    regular expression where one definition stands for numbered columns (``rho1_mm``, ``rho2_mm``, ...).
    """

    name: str
    kind: Kind
    meaning: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    nullable: bool = False
    choices: tuple[str, ...] = ()
    family: str = ""

    def matches(self, name: str) -> bool:
        """Whether this definition covers the column called ``name``."""
        return re.fullmatch(self.family, name) is not None if self.family else name == self.name


def _real(name: str, unit: str, meaning: str, **bounds: object) -> Column:
    return Column(name, "real", meaning, unit, **bounds)  # type: ignore[arg-type]


_IDENTITY = (
    Column("pose", "identifier", "the pose, as the campaign numbers or names it"),
    Column("body", "text", "the rigid body: base, platform, leg1..leg6, or any name without a mechanism"),
    Column("parent", "text", "the frame a pose is given in: a body's name, or measurement"),
    Column("target", "text", "the target on its body"),
    Column("leg", "integer", "the leg, counted from 1; empty where no leg is concerned", minimum=1, nullable=True),
    Column("run", "identifier", "the run of a loading campaign"),
    Column("step", "integer", "the load step within its run, in the order taken", minimum=0),
    Column("role", "text", "what the pose or run serves", choices=("calibration", "verification", "reference")),
    _real("time_s", "s", "when it was taken; orders poses and steps"),
    Column("subject", "text", "what a row concerns; empty for the whole", nullable=True),
    Column("stage", "text", "the stage that speaks"),
    Column("reason", "text", "why it was left out; empty where it was not", nullable=True),
    Column("message", "text", "one sentence for the engineer"),
    Column("status", "text", "how the fit ended; ok, or what prevented it"),
    Column("unit", "text", "the unit of the numbers in this row", nullable=True),
    Column("model", "text", "the model: of deformation, or of the structure (6-pus, jacobian, beam, stiffness)"),
    Column("axis", "text", "the axis of the body frame", choices=("x", "y", "z"), nullable=True),
    Column("drive", "text", "the column that the response follows", nullable=True),
)

_CAMPAIGN_LIFE = (
    Column("called", "text", "what the files call the target"),
    Column("from_pose", "text", "the first pose of which it holds; empty: from the first on", nullable=True),
    Column("to_pose", "text", "the last pose of which it holds; empty: to the last", nullable=True),
    Column("later_survey", "text", "the survey that is compared with those before it"),
    *(
        _real(f"shift_{a}_mm", "mm", f"by how much the survey has the target elsewhere along {a}", nullable=True)
        for a in "xyz"
    ),
    _real("distance_mm", "mm", "how far it lies from the target's place on the body", minimum=0.0),
    Column("entry", "text", "which entry of campaign.toml, counted from 1"),
    Column("decided_on", "text", "the day of the decision; empty where it was not written down", nullable=True),
    Column("gross_anyway", "integer", "rows that would be left out as gross errors by themselves", minimum=0),
    _real(
        "largest_change",
        "",
        "by how much the result would be another at most, without the exclusions, in the unit of its row",
        minimum=0.0,
        nullable=True,
    ),
    _real(
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

_REPEATS = (
    Column(
        "repeat_of",
        "text",
        "the pose that this one repeats, by its name; empty where it repeats none",
        nullable=True,
    ),
    Column("repeated", "text", "what came out again", choices=("pose", "point", "attachment", "reading", "signal")),
    _real("pure_error", "", "one standard deviation of a repeat, in the unit of its row", minimum=0.0),
    _real("declared_sigma", "", "one standard deviation as stated, in the unit of its row", minimum=0.0, nullable=True),
    _real("freedom_of_error", "", "degrees of freedom of the pure error", minimum=0.0),
    _real("freedom_of_fit", "", "degrees of freedom that the model leaves beside the pure error", minimum=0.0),
    Column("groups", "integer", "how many poses or programmes of loads were repeated", minimum=1),
    Column("told_by", "text", "how repeats are known: repeat_of, the same readings, or the same loads in one order"),
    Column("contender", "text", "the model that is held against pure error"),
    _real("f_ratio", "", "what the model leaves beside pure error over that, per degree of freedom", minimum=0.0),
)

_POINTS = (
    *(_real(f"{a}_mm", "mm", f"{a} coordinate in the frame of the file") for a in "xyz"),
    *(_real(f"sigma_{a}_mm", "mm", f"one standard deviation of {a}", minimum=0.0, nullable=True) for a in "xyz"),
    *(
        _real(
            f"corr_{p}", "", f"correlation of the errors in {p[0]} and {p[1]}", minimum=-1.0, maximum=1.0, nullable=True
        )
        for p in ("xy", "xz", "yz")
    ),
)

_CONFIGURATIONS = (
    Column("rho", "real", "actuator reading of that leg, rho0 + delta rho", "mm", family=r"rho[1-9]\d*_mm"),
    _real("temperature_c", "degC", "temperature of the mechanism", minimum=-273.15, nullable=True),
)

_POSES = (
    Column(
        "method",
        "text",
        "the estimator; model where the extended model predicts",
        choices=("umeyama", "haralick", "maximum_likelihood", "procrustes", "scan", "model"),
    ),
    Column("default", "flag", "whether this row feeds the following stages"),
    *(_real(f"p{a}_mm", "mm", f"{a} of the body's origin in the parent frame", nullable=True) for a in "xyz"),
    *(_real(f"r{a}_rad", "rad", f"{a} component of the rotation vector, body to parent", nullable=True) for a in "xyz"),
    *(
        _real(
            f"cov_{i}_{j}", "SI", "covariance, order p then theta, R <- exp(theta) R in the parent frame", nullable=True
        )
        for i in range(6)
        for j in range(i, 6)
    ),
    _real("rms_mm", "mm", "root mean square of the residuals of the targets kept", minimum=0.0, nullable=True),
    Column("n_used", "integer", "targets, points of a scan or readings that entered the fit", minimum=0),
    Column(
        "n_rejected",
        "integer",
        "targets, points of a scan or readings kept out as gross errors or by a person",
        minimum=0,
    ),
    _real("overlap", "", "share of a scan's points that lie on the reference surface", minimum=0.0, maximum=1.0),
    _real("noise_ratio", "", "by which the standard deviations were enlarged for what noise leaves open", minimum=1.0),
)

_RESIDUALS = (
    *(_real(f"d{a}_mm", "mm", f"measured minus fitted along {a}", nullable=True) for a in "xyz"),
    _real("weight", "", "weight in the fit, 0 (kept out) to 1", minimum=0.0, maximum=1.0),
    Column("rejected", "flag", "whether the target was kept out as a gross error or by a person"),
)

_DEFORMATION = (
    _real("delta_rho_mm", "mm", "actuator displacement from its reference reading"),
    _real("delta_bz_um", "um", "shift of the attachment along z of the platform, from its place in the survey"),
    _real("sigma_um", "um", "one standard deviation, all known noise propagated", minimum=0.0),
    _real("own_sigma_um", "um", "the part of it that the attachment's own targets bring along z", minimum=0.0),
    _real("displacement_um", "um", "shift of a target in its body frame from its place in the survey"),
    Column("significant", "flag", "whether it differs from zero at the stated false-alarm rate", nullable=True),
    Column("column", "integer", "which drive the coefficient multiplies, counted from 1; 0 is the offset", minimum=0),
    _real("coefficient", "", "response per unit of drive, in the unit of its row"),
    _real("sigma", "", "one standard deviation of the number beside it", minimum=0.0, nullable=True),
    _real(
        "p_value",
        "",
        "probability of a deviation at least this large by chance",
        minimum=0.0,
        maximum=1.0,
        nullable=True,
    ),
    Column("figure", "text", "the name of the figure"),
    _real("value", "", "the number, in the unit of its row", nullable=True),
)

_CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz", *(f"v{number}" for number in range(1, 9)))

_LOADS = (
    *(_real(f"f{a}_n", "N", f"force along {a} on the platform at its origin", nullable=True) for a in "xyz"),
    *(_real(f"m{a}_nm", "N m", f"torque about {a} on the platform", nullable=True) for a in "xyz"),
    Column("response", "text", "component of the response", choices=("dx", "dy", "dz", "rx", "ry", "rz")),
    Column("load", "text", "component of the wrench", choices=("fx", "fy", "fz", "mx", "my", "mz")),
    Column("channel", "text", "what was read: a motion of the platform, or a signal of the sensor", choices=_CHANNELS),
    _real("reading", "", "motion of the platform since the start of the run, in the unit of its row"),
    Column("signal", "real", "signal of that channel of the force sensor", "mV", nullable=True, family=r"v[1-8]_mv"),
    Column("samples", "integer", "how many samples of the raw signals", minimum=1),
    *(_real(f"{a}0", "", f"middle of the ellipse along {a}, in the unit of the signals") for a in "xy"),
    *(_real(f"amplitude_{a}", "", f"half axis of the ellipse along {a}", minimum=0.0) for a in "xy"),
    _real("lag_rad", "rad", "by how much the second signal departs from a quarter of a fringe behind the first"),
    _real("radius_before", "", "standard deviation of the radius of the signals as they are", minimum=0.0),
    _real("radius_after", "", "the same once the ellipse of all samples is taken out", minimum=0.0),
    _real("radius_uncut", "", "the same of the samples that no end of the range cuts, by their ellipse", minimum=0.0),
    _real("radius_mean", "", "mean radius of the signals", minimum=0.0),
    _real(
        "geometry", "", "what the declared geometry of its beam adds to a reading; empty where unknown", nullable=True
    ),
    _real("geometry_sigma", "", "one sigma of that, in proportion to it", minimum=0.0, nullable=True),
    Column("correction", "text", "what was corrected", choices=("air", "material")),
    _real(
        "largest", "", "the largest change, in the unit of its row; empty where readings came corrected", nullable=True
    ),
    _real("cut_share", "", "share of samples at an end of the converter's range", minimum=0.0, maximum=1.0),
    _real("periodic_error_um", "um", "largest error of lengths without the ellipse's correction", minimum=0.0),
    _real("miscount_risk", "", "largest probability of any step to be counted wrong", minimum=0.0, maximum=1.0),
    _real("target_mm", "mm", "where an axis was sent"),
    Column("direction", "text", "the side that a target was approached from", choices=("forward", "backward")),
    Column("cycle", "integer", "which of the repeated approaches", minimum=1),
    _real("position_mm", "mm", "where the axis stood, by the reference"),
    _real("low", "", "lower end of the interval of 95 %, in the unit of its row", nullable=True),
    _real("high", "", "upper end of the interval of 95 %, in the unit of its row", nullable=True),
    Column("case", "integer", "the load case: the same loads, reached the same way", minimum=1),
    Column(
        "branch",
        "text",
        "whether the load grew away from zero or came back; several loads at once: the largest in its range",
        choices=("unloaded", "loading", "unloading"),
    ),
    _real("applied", "", "load along the axis of its row, N or N m", nullable=True),
    _real("measured", "", "what was measured, in the unit of its row"),
    _real("simulated", "", "what the simulation gives instead of the number beside it", nullable=True),
    _real("simulated_sigma", "", "one standard deviation of it by the tolerances", minimum=0.0, nullable=True),
    _real("residual", "", "measured minus fitted, in the unit of its row", nullable=True),
    Column("term", "text", "what a number multiplies"),
    _real("air_temperature_c", "degC", "temperature of the air along the beams", minimum=-273.15, nullable=True),
    _real("air_pressure_hpa", "hPa", "pressure of the air", minimum=0.0, nullable=True),
    _real("relative_humidity_pct", "%", "humidity of the air", minimum=0.0, maximum=100.0, nullable=True),
    _real("material_temperature_c", "degC", "temperature of the platform and its legs", minimum=-273.15, nullable=True),
)

_QUALITY = (
    Column("check", "text", "the name of the check"),
    _real("limit", "", "the limit that the verdict rests on, in the unit of its row", nullable=True),
    Column("accepted", "text", "who accepted the verdict and why; empty where nobody did", nullable=True),
    Column("rows", "integer", "how many rows it concerns", minimum=0),
    Column("by", "text", "the rule, or the person, that left them out"),
)

_DIAGNOSIS = (
    Column("rank", "integer", "1 is the most probable", minimum=1),
    Column("cause", "text", "an id of the catalogue, or unexplained"),
    Column(
        "verdict",
        "text",
        "the finding: pass, warn, fail; found, indistinguishable, rejected; or agrees, differs",
        nullable=True,
    ),
    _real("probability", "", "among the candidates, given the data", minimum=0.0, maximum=1.0, nullable=True),
    Column("parameters", "text", "JSON: name to value, sigma and unit"),
    Column("follows", "text", "for unexplained: the columns that it follows, separated by blanks", nullable=True),
    *(
        _real(
            f"{held}rms_{when}",
            "unit",
            f"rms of measured minus predicted {when} this row is accepted",
            minimum=0.0,
            nullable=True,
        )
        for held in ("", "heldout_")
        for when in ("before", "after")
    ),
    _real(
        "noise_floor", "unit", "what the declared noise leaves after the fitted parameters", minimum=0.0, nullable=True
    ),
    Column("explanation", "text", "what, where, how large, how sure"),
    Column("next_measurement", "text", "what to measure to confirm it, or to tell it from its rivals", nullable=True),
    _real(
        "signal_to_noise", "", "the effect over its noise, all nuisances taken out of it", minimum=0.0, nullable=True
    ),
    _real("log_evidence", "", "logarithm of the odds against the model without it", nullable=True),
    Column(
        "scale_holds",
        "text",
        "whether its place in the ranking stays when plausible scales are tripled",
        nullable=True,
        choices=("holds", "changes"),
    ),
)

_EXTENSION = (
    _real("size", "", "the smallest size that is found with the probability beside it", minimum=0.0, nullable=True),
    _real("power", "", "the probability of being found at that size", minimum=0.0, maximum=1.0),
    *(
        _real(f"pull_{when}", "", f"shift over what the data let it differ by, {model}", nullable=True)
        for when, model in (("before", "no effect in the model"), ("after", "found effects in the model"))
    ),
    _real("chi_square", "", "the pulls together, their correlations taken into account", minimum=0.0, nullable=True),
    Column("freedom", "integer", "how many independent pulls there are", minimum=0),
    *(
        _real(f"largest_{when}", "unit", f"largest of measured minus predicted {when} the extension", minimum=0.0)
        for when in ("before", "after")
    ),
    Column("purpose", "text", "what a measurement is for: the cause to confirm, or the two to tell apart"),
    Column("expected", "text", "what is expected once this and those before it are measured", nullable=True),
    Column("conditions", "text", "what else to see to: approach, pause, pace, surroundings", nullable=True),
    Column("channels", "text", "what is read, separated by blanks"),
    Column("times", "integer", "how often all of them are needed; empty: no number is enough", nullable=True),
    _real("before", "", "the parameter as the earlier campaign left it, in the unit of its row", nullable=True),
    _real("sigma_before", "", "one standard deviation of it then", minimum=0.0, nullable=True),
    _real("now", "", "the parameter as this campaign alone has it", nullable=True),
    _real("sigma_now", "", "one standard deviation of it now", minimum=0.0, nullable=True),
    _real("sigma_difference", "", "one standard deviation of now minus before", minimum=0.0, nullable=True),
    _real("z", "", "now minus before, over its standard deviation", nullable=True),
    _real("change", "", "by how much it changed, were the changed ones the only ones", nullable=True),
    _real("sigma_change", "", "one standard deviation of that", minimum=0.0, nullable=True),
    Column("instead", "text", "numbers whose change in its place would explain as much", nullable=True),
    Column("changed", "flag", "whether it is among the fewest numbers whose changes explain all differences"),
)

_COMPARED = (
    Column("place", "integer", "the run's place in the order in which the runs were named", minimum=1),
    Column("folder", "text", "the run's folder, as it was named"),
    Column("campaign", "text", "the campaign that the run is of"),
    Column("group", "text", "what the number is of", choices=("geometry", "effect", "compliance", "G_B")),
    _real("difference", "", "the number minus that of the run before, in the unit of its row", nullable=True),
)

_READING_ERRORS = tuple(
    _real(f"missed_{when}", "unit", f"measured minus predicted {when} the extension, in the unit of its row")
    for when in ("before", "after")
)

_FITTED = ("errors-in-variables", "implicit", "nominal", "points")
_DEFORMING = ("none", "linear", "nonlinear", "matrix")

_CALIBRATION = (
    Column("deformation", "text", "how the platform deforms in the model", choices=_DEFORMING),
    Column("parameter", "text", "the parameter: a_x, b_y, u_x, l, rho0, kappa, K12, ..."),
    _real("nominal", "", "the parameter before calibration, in the unit of its row", nullable=True),
    _real("identified", "", "the parameter after calibration", nullable=True),
    _real("tolerance", "", "one standard deviation of manufacturing and assembly", minimum=0.0, nullable=True),
    _real("pull", "", "difference from nominal over what tolerance and measurement let it differ by", nullable=True),
    Column("identifiable", "flag", "whether the data tell the parameter better than its tolerance does"),
    Column("effect_of", "text", "the cause and its subject; empty for the machine's own numbers", nullable=True),
    Column("other_leg", "integer", "the leg of the other parameter, counted from 1", minimum=1, nullable=True),
    Column("other_parameter", "text", "the other parameter of a pair"),
    _real("correlation", "", "correlation of the two errors", minimum=-1.0, maximum=1.0),
    _real("position_error_um", "um", "distance between measured and predicted platform origin", minimum=0.0),
    _real("orientation_error_arcsec", "arcsec", "angle between measured and predicted platform", minimum=0.0),
    *(_real(f"d{a}_um", "um", f"measured minus predicted along {a} of the base", nullable=True) for a in "xyz"),
    *(_real(f"r{a}_arcsec", "arcsec", f"measured minus predicted about {a} of the base", nullable=True) for a in "xyz"),
    _real("position_noise_um", "um", "rms position error that noise alone would leave", minimum=0.0, nullable=True),
    _real(
        "orientation_noise_arcsec",
        "arcsec",
        "rms orientation error that noise alone would leave",
        minimum=0.0,
        nullable=True,
    ),
    Column("estimator", "text", "how it was fitted", choices=_FITTED),
    Column("combination", "text", "parameters that cannot be told apart, in words", nullable=True),
    Column("effect", "text", "the effect that was left out of the model"),
    _real("predicted", "", "how much of the effect the parameter takes, by linear algebra before the fit"),
    _real("observed", "", "how much the parameter moved when the effect was left out of the fit", nullable=True),
)

_LOAD_NAMES = ("fx", "fy", "fz", "mx", "my", "mz")

_SENSOR = (
    Column("matrix", "text", "which matrix", choices=("G", "G'", "G_B", "G_B'", "terms")),
    Column("row", "text", "the row of a matrix: a component of the wrench, or a signal"),
    Column("column_name", "text", "the column of a matrix: a leg, a signal, or a term"),
    _real("sigma_by_case", "", "one standard deviation by leaving load cases out in turn", minimum=0.0, nullable=True),
    Column("chosen", "flag", "whether held-out loads speak for it"),
    _real("length_m", "m", "over which moments are counted; 1 m leaves them as they are", minimum=0.0, nullable=True),
    Column("error_class", "text", "the error, by the name that laboratories give it"),
    Column("indicated", "text", "the component that indicated it", choices=_LOAD_NAMES),
)

_REQUIREMENTS = (
    Column("component", "text", "position along or rotation about an axis", choices=("x", "y", "z", "rx", "ry", "rz")),
    _real("requirement", "", "the accuracy asked for, in the unit of its row", nullable=True),
    _real("error", "", "the error that 95 of 100 poses stay below", minimum=0.0, nullable=True),
    _real("lower", "", "lower end of the 95 % interval of the number beside it", minimum=0.0, nullable=True),
    _real("upper", "", "upper end of the 95 % interval of the number beside it", minimum=0.0, nullable=True),
)

RESULTS = ("pose", "calibration", "accuracy", "cause", "compliance", "G_B", "load", "positioning")
_UNCERTAINTY = (
    Column("result", "text", "what kind of result", choices=RESULTS),
    Column("quantity", "text", "which number of the subject"),
    _real("estimate", "", "the value that is stated, in the unit of its row", nullable=True),
    _real("standard_uncertainty", "", "combined standard uncertainty of the estimate", minimum=0.0, nullable=True),
    _real(
        "degrees_of_freedom",
        "",
        "of the uncertainty beside it (combined: by Welch and Satterthwaite); empty: without bound",
        minimum=0.0,
        nullable=True,
    ),
    _real("coverage_factor", "", "by which the standard uncertainty is multiplied", minimum=0.0, nullable=True),
    _real("expanded_uncertainty", "", "half the interval of 95 %", minimum=0.0, nullable=True),
    Column("stated", "flag", "whether an uncertainty is stated; else the reason says why not"),
    Column("input_source", "text", "the source of uncertainty"),
    Column(
        "evaluation",
        "text",
        "A: from observations of this campaign; B: declared; or not evaluated, and so no part of the budget",
        choices=("A", "B", "not evaluated"),
    ),
    Column("distribution", "text", "the distribution that the source is taken to have", nullable=True),
    _real("contribution", "", "standard uncertainty that the source gives to the result", minimum=0.0, nullable=True),
    _real("share_of_variance", "", "its share in the squared uncertainty", minimum=0.0, maximum=1.0, nullable=True),
)

COLUMNS: dict[str, Column] = {
    column.name: column
    for group in (
        _IDENTITY,
        _CAMPAIGN_LIFE,
        _REPEATS,
        _POINTS,
        _CONFIGURATIONS,
        _POSES,
        _RESIDUALS,
        _DEFORMATION,
        _LOADS,
        _QUALITY,
        _DIAGNOSIS,
        _EXTENSION,
        _COMPARED,
        _READING_ERRORS,
        _CALIBRATION,
        _SENSOR,
        _REQUIREMENTS,
        _UNCERTAINTY,
    )
    for column in group
}


def find_column(name: str) -> Column | None:
    """The definition that covers a column's name, families included, or None."""
    exact = COLUMNS.get(name)
    if exact is not None and not exact.family:
        return exact
    return next((column for column in COLUMNS.values() if column.family and column.matches(name)), None)
