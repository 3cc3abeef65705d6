"""Artifacts of deformation, calibration, requirements and uncertainty."""

from __future__ import annotations

from itertools import combinations

from truing.schemas.artifact import Artifact, parquet
from truing.schemas.measured_artifacts import WRENCH
from truing.schemas.photograph_artifacts import POINT

_WRENCH_SIGMA = " ".join(f"sigma_{name}" for name in WRENCH.split())
_WRENCH_COVARIANCE = " ".join(f"cov_{a}_{b}" for a, b in combinations(("fx", "fy", "fz", "mx", "my", "mz"), 2))
_ACCURACY_PARTS = "dx_um dy_um dz_um rx_arcsec ry_arcsec rz_arcsec"
_ACCURACY_NOISE = "position_noise_um orientation_noise_arcsec"

CALIBRATION = (
    parquet(
        "deformation",
        "shift of each attachment along z of the platform",
        "pose* leg* delta_rho_mm delta_bz_um sigma_um",
        optional="own_sigma_um scatter_sigma_um delta_bx_um delta_by_um sigma_bx_um sigma_by_um p_value significant "
        "rejected reason",
    ),
    parquet(
        "target_deformation",
        "shift of each target in its body frame, for campaigns without [mechanism]",
        "pose* body* target* axis* displacement_um sigma_um",
    ),
    parquet(
        "deformation_models",
        "coefficients of the deformation models",
        "model leg column coefficient sigma",
        optional="unit body target axis drive p_value significant",
    ),
    parquet(
        "deformation_errors",
        "errors of each deformation model",
        "model leg figure value unit",
        optional="subject",
    ),
    parquet(
        "simulated_deformation",
        "entries of the measured K minus those of the simulated one",
        "leg* column* measured sigma simulated simulated_sigma difference pull verdict unit",
    ),
    parquet(
        "compliance",
        "entries of the compliance (displacement per load), fitted by each model and simulated",
        "model* response* load* coefficient sigma unit",
        optional="p_value significant simulated simulated_sigma pull verdict",
    ),
    parquet(
        "positioning",
        "ISO 230-2 positioning: quantities of each target, and of the axis (empty subject)",
        "run* figure* subject* value unit",
        optional="sigma low high",
    ),
    parquet(
        "axis_curves",
        "displacement over load of the load cases along one axis: measured, and simulated if known",
        "load* channel* case* branch applied measured sigma unit",
        optional="simulated simulated_sigma",
    ),
    parquet(
        "neglected",
        "change of each entry of the simulated compliance by an effect that the simulation neglects",
        "effect* response* load* coefficient effect_change sigma effect_over_sigma verdict unit",
    ),
    parquet(
        "own_weight",
        "mass and weight of a sensor, its displacement under own weight, and the tensions of its legs",
        "figure* subject* value unit",
    ),
    parquet(
        "frames",
        "origins and axes of a sensor's frames (unloaded), or of a machine on legs at its reference readings, in the "
        "frame of the base",
        f"frame* axis_name* {POINT} along_x along_y along_z",
    ),
    parquet(
        "published_compared",
        "published displacements compared with those of this campaign at the same load",
        "load* channel* applied* source* published unit own own_sigma allowed_difference verdict",
        optional="published_in",
    ),
    parquet(
        "tolerance_errors",
        "force sensor as designed: errors of its platform by each tolerance, and by all at once",
        "error_source* pose_part* tolerance_width_um unit first_order sample_rms low high error_95 variance_share "
        "open_chains",
    ),
    parquet(
        "tolerance_samples",
        "force sensor as designed: platforms of a hundred sensors drawn within each tolerance, and within all",
        "error_source* sample* platform_shift_um platform_turn_arcsec",
    ),
    parquet(
        "calibration",
        "parameters identified by errors in variables with tolerances as prior, also those of the extended model",
        "model* deformation* leg* parameter* unit nominal identified sigma tolerance pull identifiable status",
        optional="effect_of*",
    ),
    parquet(
        "arm_accuracy",
        "ISO 9283 figures of an arm at each repeated pose (named by its first): AP, RP, vAP, drift dAP and dRP, "
        "distance to another pose AD and RD, and those of angles about x, y, z (a, b, c)",
        "subject* pose* figure* value unit attained",
        optional="other_pose* low high",
    ),
    parquet(
        "series_errors",
        "root mean square of measured minus predicted positions, or distances, of a chain, by series",
        "series* role* poses rms_before rms_after unit",
    ),
    parquet(
        "motor_encoders",
        "motor encoders compared with the readings of their joints: ratio, lost motion, wind-up, waves, what remains",
        "joint* parameter* unit value sigma identifiable",
    ),
    parquet(
        "chain_parameters",
        "identified numbers of a chain: zero of each joint, and shift and rotation of its frame in the link below",
        "joint* parameter* unit identified sigma tolerance pull identifiable",
    ),
    parquet(
        "chain_inseparable",
        "numbers of a chain that its measurements do not separate: members of each combination whose change moves no "
        "measurement, or less than the numbers were known before; and what would separate them",
        "combination_number* number_kind subject* parameter* unit number_change remedy separating_pose",
    ),
    parquet(
        "joint_curves",
        "error curves of joints that the extended model holds: motion minus reading, along the reading",
        "joint* joint_reading_si* deviation_si deviation_sigma_si is_determined",
    ),
    parquet(
        "guideway_errors",
        "errors of guideways that the extended model holds, along the slide: a shift from the line through both ends "
        "of the travel, a turn from the direction at its start; and the span of the measured readings",
        "joint* guideway_motion* guideway_axis* joint_reading_si* guideway_error_si guideway_sigma_si "
        "measured_from_si measured_to_si",
    ),
    parquet(
        "implicit_calibration",
        "parameters identified by least squares on the closure alone, as in the telescope report (eq. 30-33)",
        "model* deformation* leg* parameter* unit nominal identified sigma tolerance pull identifiable status",
    ),
    parquet(
        "correlations",
        "correlated pairs of parameters in calibration.parquet, from a correlation of 0.05 in size",
        "model deformation leg parameter other_leg other_parameter correlation",
    ),
    parquet(
        "accuracy",
        "measured minus predicted pose for every model of calibration.parquet",
        "model* deformation* pose* role position_error_um orientation_error_arcsec",
        optional=f"{_ACCURACY_PARTS} {_ACCURACY_NOISE}",
    ),
    parquet(
        "implicit_accuracy",
        "measured minus predicted pose for every model of implicit_calibration.parquet",
        "model* deformation* pose* role position_error_um orientation_error_arcsec",
        optional=f"{_ACCURACY_PARTS} {_ACCURACY_NOISE}",
    ),
    parquet(
        "repeats",
        "scatter of repeated measurements (pure error) with 95 % interval, and the declared noise",
        "repeated* subject* pure_error lower upper declared_sigma unit freedom_of_error groups told_by",
        optional="p_equal",
    ),
    parquet(
        "pose_repeatability",
        "repeatability of bodies and single reflectors at each repeated pose (named by its first): sigma of a "
        "coordinate, RP and RP_a to RP_c of ISO 9283, with 95 % intervals",
        "subject* pose* figure* value low high unit attained told_by",
    ),
    parquet(
        "lack_of_fit",
        "F test of each model's residuals against pure error, per subject",
        "repeated* contender* subject* f_ratio freedom_of_fit freedom_of_error p_value",
    ),
    parquet(
        "model_choice",
        "criteria by which one calibration is chosen, for every calibration",
        "model* deformation* estimator* figure* value unit",
    ),
    parquet(
        "observability",
        "observability of the parameters: rank, indices, and combinations that the data do not separate",
        "model deformation leg figure value unit combination",
    ),
    parquet(
        "flexure_parameters",
        "design parameters of flexures and legs in the models that use them: effect of one tolerance on the closure, "
        "and whether the data determine them",
        "model* leg* parameter* unit nominal tolerance sensitivity_um closure_noise_um sigma_over_tolerance "
        "identifiable",
    ),
    parquet(
        "absorption",
        "bias of the parameters by an effect that the model leaves out: predicted, and observed in the fit",
        "effect* model* deformation* estimator* leg* parameter* unit predicted observed sigma",
    ),
    parquet(
        "sensor_matrix",
        "matrices of a force sensor: G, G' by its drawing, G_B by its calibrations, G_B' by the chosen one; its terms",
        "matrix* model* row* column_name* value sigma unit chosen",
        optional="sigma_by_case",
    ),
    parquet(
        "sensor_merit",
        "figures of merit of these matrices, for moments in N m (length 1 m) and over a characteristic length",
        "matrix model length_m figure value sigma unit",
        optional="subject",
    ),
    parquet(
        "sensor_choice",
        "criteria by which one calibration of a force sensor is chosen, and reasons why others were not fitted",
        "model figure value unit",
        optional="subject reason",
    ),
    Artifact("sensor", "sensor.toml", "chosen calibration of a force sensor, which converts signals to the wrench"),
    parquet(
        "wrenches",
        "wrench of each row of signals by the chosen calibration, with its covariance",
        f"row_order* {WRENCH} {_WRENCH_SIGMA} {_WRENCH_COVARIANCE} is_within",
        optional="run step time_s",
    ),
    parquet(
        "calibrations_compared",
        "held-out errors of the calibration of the recorded data and of the one with findings applied; is_main marks "
        "the one that all other tables use",
        "data* is_main findings model quantity* tested_on* rms_error largest_error rms_unchanged count unit",
        optional="deformation noise_rms",
    ),
    parquet(
        "second_campaign_errors",
        "errors of predictions for a second campaign of the same machine, by models fitted to this one: nominal, "
        "calibrated, and extended with the persistent findings",
        "campaign prediction_by* model quantity* rms_error largest_error noise_rms count unit",
        optional="p_worse beyond_range",
    ),
    parquet(
        "error_classes",
        "errors of the calibrated sensor in laboratory terms, per axis; a row without value gives the reason",
        "error_class* load* indicated* value sigma limit unit",
        optional="applied reason",
    ),
    parquet(
        "requirements",
        "required and achieved accuracy; model uncorrected: of an axis as it is",
        "model* deformation* component* requirement error lower upper unit verdict message",
        optional="poses_judged p_value measurements lower_expected upper_expected",
    ),
    parquet(
        "uncertainty",
        "statement of uncertainty: every reported result with standard and expanded uncertainty",
        "result* subject* quantity* estimate standard_uncertainty degrees_of_freedom coverage_factor "
        "expanded_uncertainty unit stated reason",
    ),
    parquet(
        "uncertainty_budget",
        "contribution of each source to these uncertainties, and sources not evaluated with the reason",
        "result subject quantity input_source evaluation distribution contribution degrees_of_freedom "
        "share_of_variance unit reason",
    ),
)
