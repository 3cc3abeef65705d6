"""What is left of models fitted to a campaign: deformation, compliance, geometry, and how well they are known."""

from __future__ import annotations

from truing.schemas.artifact import parquet

_ABSORPTION = ("effect", "model", "deformation", "estimator", "leg", "parameter")
_CALIBRATION = ("model", "deformation", "leg", "parameter", "unit", "nominal", "identified", "sigma", "tolerance")
_ACCURACY = ("model", "deformation", "pose", "role", "position_error_um", "orientation_error_arcsec")
_ACCURACY_PARTS = ("dx_um", "dy_um", "dz_um", "rx_arcsec", "ry_arcsec", "rz_arcsec")
_ACCURACY_NOISE = ("position_noise_um", "orientation_noise_arcsec")

CALIBRATION = (
    parquet(
        "deformation",
        "shift of each attachment along z of the platform",
        ("pose", "leg", "delta_rho_mm", "delta_bz_um", "sigma_um"),
        optional=("own_sigma_um", "scatter_sigma_um", "p_value", "significant", "rejected", "reason"),
        key=("pose", "leg"),
    ),
    parquet(
        "target_deformation",
        "shift of each target in its body frame, where no mechanism says what drives it",
        ("pose", "body", "target", "axis", "displacement_um", "sigma_um"),
        key=("pose", "body", "target", "axis"),
    ),
    parquet(
        "deformation_models",
        "coefficients of the deformation models",
        ("model", "leg", "column", "coefficient", "sigma"),
        optional=("unit", "body", "target", "axis", "drive", "p_value", "significant"),
    ),
    parquet(
        "deformation_errors",
        "error figures of each deformation model",
        ("model", "leg", "figure", "value", "unit"),
        optional=("subject",),
    ),
    parquet(
        "compliance",
        "displacement per load, entry by entry: by each model as far as it is known, and simulated",
        ("model", "response", "load", "coefficient", "sigma", "unit"),
        optional=("p_value", "significant", "simulated", "simulated_sigma", "pull", "verdict"),
        key=("model", "response", "load"),
    ),
    parquet(
        "positioning",
        "positioning of an axis by ISO 230-2: quantities of each target, and of the axis (empty subject)",
        ("run", "figure", "subject", "value", "unit"),
        optional=("sigma", "low", "high"),
        key=("run", "figure", "subject"),
    ),
    parquet(
        "axis_curves",
        "displacement against load of the load cases along one axis alone: measured, and simulated where that is known",
        ("load", "channel", "case", "branch", "applied", "measured", "sigma", "unit"),
        optional=("simulated", "simulated_sigma"),
        key=("load", "channel", "case"),
    ),
    parquet(
        "calibration",
        "parameters identified by errors in variables, tolerances as prior; and those of the extended model",
        (*_CALIBRATION, "pull", "identifiable", "status"),
        optional=("effect_of",),
        key=("model", "deformation", "leg", "parameter", "effect_of"),
    ),
    parquet(
        "implicit_calibration",
        "the same by least squares on the closure alone, as the telescope report does (eq. 30-33)",
        (*_CALIBRATION, "pull", "identifiable", "status"),
        key=("model", "deformation", "leg", "parameter"),
    ),
    parquet(
        "correlations",
        "correlated pairs of identified parameters in calibration.parquet, |correlation| of 0.05 and more",
        ("model", "deformation", "leg", "parameter", "other_leg", "other_parameter", "correlation"),
    ),
    parquet(
        "accuracy",
        "measured minus predicted pose for every model of calibration.parquet",
        _ACCURACY,
        optional=(*_ACCURACY_PARTS, *_ACCURACY_NOISE),
        key=("model", "deformation", "pose"),
    ),
    parquet(
        "implicit_accuracy",
        "the same for every model of implicit_calibration.parquet",
        _ACCURACY,
        optional=(*_ACCURACY_PARTS, *_ACCURACY_NOISE),
        key=("model", "deformation", "pose"),
    ),
    parquet(
        "repeats",
        "what was measured more than once: its scatter (pure error) with its 95 % interval, against what is stated",
        (
            *("repeated", "subject", "pure_error", "lower", "upper", "declared_sigma", "unit"),
            *("freedom_of_error", "groups", "told_by"),
        ),
        optional=("p_equal",),
        key=("repeated", "subject"),
    ),
    parquet(
        "pose_repeatability",
        "repeatability at every pose that was repeated, of bodies and single reflectors: sigma of a coordinate, RP and "
        "RP_a to RP_c of ISO 9283 with intervals of 95 %; pose: the first of its group",
        ("subject", "pose", "figure", "value", "low", "high", "unit", "attained", "told_by"),
        key=("subject", "pose", "figure"),
    ),
    parquet(
        "lack_of_fit",
        "the F test of what each model leaves against pure error, subject by subject",
        ("repeated", "contender", "subject", "f_ratio", "freedom_of_fit", "freedom_of_error", "p_value"),
        key=("repeated", "contender", "subject"),
    ),
    parquet(
        "model_choice",
        "figures of every calibration, by which one is chosen",
        ("model", "deformation", "estimator", "figure", "value", "unit"),
        key=("model", "deformation", "estimator", "figure"),
    ),
    parquet(
        "observability",
        "what the data can know of the parameters: rank, indices, and what cannot be told apart",
        ("model", "deformation", "leg", "figure", "value", "unit", "combination"),
    ),
    parquet(
        "absorption",
        "which parameters swallow an effect that the model leaves out: predicted, and what the fit did",
        (*_ABSORPTION, "unit", "predicted", "observed", "sigma"),
        key=_ABSORPTION,
    ),
    parquet(
        "sensor_matrix",
        "matrices of a force sensor: G, G' by its drawing, G_B by its calibrations, G_B' by the chosen one; its terms",
        ("matrix", "model", "row", "column_name", "value", "sigma", "unit", "chosen"),
        optional=("sigma_by_case",),
        key=("matrix", "model", "row", "column_name"),
    ),
    parquet(
        "sensor_merit",
        "figures of merit of these matrices, moments as they are (length 1 m) and over a characteristic length",
        ("matrix", "model", "length_m", "figure", "value", "sigma", "unit"),
        optional=("subject",),
    ),
    parquet(
        "sensor_choice",
        "figures of every calibration of a force sensor, by which one is chosen; and why others could not be made",
        ("model", "figure", "value", "unit"),
        optional=("subject", "reason"),
    ),
    parquet(
        "error_classes",
        "errors of the calibrated sensor as laboratories report them, per axis; empty, with the reason, where not told",
        ("error_class", "load", "indicated", "value", "sigma", "limit", "unit"),
        optional=("applied", "reason"),
        key=("error_class", "load", "indicated"),
    ),
    parquet(
        "requirements",
        "the accuracy asked for against the accuracy reached",
        (
            "model",
            "deformation",
            "component",
            "requirement",
            "error",
            "lower",
            "upper",
            "unit",
            "verdict",
            "message",
        ),
        key=("model", "deformation", "component"),
    ),
    parquet(
        "uncertainty",
        "statement of uncertainty: every result that is quoted, with its standard and its expanded uncertainty",
        (
            *("result", "subject", "quantity", "estimate", "standard_uncertainty", "degrees_of_freedom"),
            *("coverage_factor", "expanded_uncertainty", "unit", "stated", "reason"),
        ),
        key=("result", "subject", "quantity"),
    ),
    parquet(
        "uncertainty_budget",
        "what each source gives to these uncertainties; and what is no part of them, with the reason",
        (
            *("result", "subject", "quantity", "input_source", "evaluation", "distribution", "contribution"),
            *("degrees_of_freedom", "share_of_variance", "unit", "reason"),
        ),
    ),
)
