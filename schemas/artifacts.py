"""Definitions of all artifacts of a run, by name."""

from __future__ import annotations

from itertools import combinations

from truing.schemas.artifact import Artifact, parquet
from truing.schemas.photograph_artifacts import CORRELATION, COVARIANCE, PHOTOGRAPHS, PLACE, POINT, SIGMA

_WRENCH = "fx_n fy_n fz_n mx_nm my_nm mz_nm"
_WRENCH_SIGMA = " ".join(f"sigma_{name}" for name in _WRENCH.split())
_WRENCH_COVARIANCE = " ".join(f"cov_{a}_{b}" for a, b in combinations(("fx", "fy", "fz", "mx", "my", "mz"), 2))
_SURROUNDINGS = "air_temperature_c air_pressure_hpa relative_humidity_pct material_temperature_c"

# Columns on what to measure next: need, effort and expected gain.
_PLANNED = "need measurements duration_s sigma_now sigma_expected unit odds_expected repeat_of"

_MEASUREMENT = (
    parquet(
        "observations",
        "object points as read, in uniform names and units, one row per pose, body and target",
        f"pose* body* target* {POINT} {SIGMA}",
        optional=f"{CORRELATION} point",
    ),
    parquet(
        "survey",
        "reference survey of the targets, in the frame of each body",
        f"body* target* {POINT} {SIGMA} leg",
        optional=CORRELATION,
    ),
    parquet(
        "measured_poses",
        "poses that the instrument reported, in its own frame, with their declared covariance",
        f"pose* body* {PLACE} {COVARIANCE}",
    ),
    parquet(
        "scans",
        "pose of each body from a dense scan of its surface, in the frame of the measurement",
        f"pose* body* {PLACE} {COVARIANCE} rms_mm n_used n_rejected overlap noise_ratio status message",
    ),
    parquet(
        "configurations",
        "one row per pose: role, time, actuator readings, covariates",
        "pose* role time_s",
        optional="temperature_c repeat_of event series",
        families="rho",
        covariates=True,
    ),
    parquet(
        "distances",
        "measured distances between targets of links, or from a target to a station",
        "pose* from_link from_end* to_link to_end* reading_mm sigma_mm",
    ),
    parquet(
        "joints",
        "joints of an open chain with the links that they move, as [mechanism] describes them",
        "node* joint link below joint_kind x_mm y_mm z_mm rx_rad ry_rad rz_rad axis_x axis_y axis_z follows_joint "
        "factor zero_si mass_kg com_x_mm com_y_mm com_z_mm lower_si upper_si input",
        optional="closure",
    ),
    parquet(
        "readings",
        "readings (um, arcsec) of an interferometer, compensated for air, one row per load step and channel",
        f"run* step* time_s {_WRENCH} channel* reading unit sigma",
        optional=f"role {_SURROUNDINGS}",
        covariates=True,
        file="observations.parquet",
    ),
    parquet(
        "signals",
        "signals of a force sensor, one row per load step",
        f"run* step* time_s {_WRENCH}",
        optional=f"role {_SURROUNDINGS}",
        families="signal",
        covariates=True,
    ),
    parquet(
        "loads_joined",
        "how the rows of [files.loads] were joined to those of signals",
        "joined_by signal_rows load_rows rows_matched",
        optional="largest_apart_s earlier_s later_s",
    ),
    parquet(
        "quadrature",
        "raw interferometer signals: fitted ellipse of each channel, and scatter about it",
        "channel* samples x0 y0 amplitude_x amplitude_y lag_rad radius_before radius_after radius_uncut radius_mean "
        "cut_share periodic_error_um miscount_risk status",
        optional="sigma_source",
    ),
    parquet(
        "reading_corrections",
        "largest correction of readings for air and material, and its uncertainty",
        "subject* correction* largest sigma unit",
    ),
    parquet(
        "positions",
        "measured positions of an axis at its targets, one row per approach",
        "run* target_mm* direction* cycle* position_mm",
        optional=f"{_SURROUNDINGS} position_read_mm row_order",
    ),
    parquet(
        "given_compliance",
        "simulated compliance from the campaign's compliance_file, SI",
        "response* load* coefficient unit",
    ),
    parquet(
        "given_deformation",
        "simulated K from the campaign's deformation_file: shift of an attachment along z per displacement of an "
        "actuator",
        "leg* column* coefficient sigma unit",
    ),
    parquet(
        "published",
        "published displacements under load, from the campaign's table `published`",
        "load* channel* applied* source* published unit",
        optional="published_in",
    ),
    parquet(
        "displacement",
        "displacement of the platform per load case, without zeros and drift of the runs; empty if not measured",
        f"case* branch {_WRENCH} dx_mm dy_mm dz_mm rx_rad ry_rad rz_rad {COVARIANCE} n_used n_rejected",
        optional="role",
        version=2,
    ),
    parquet(
        "reading_residuals",
        "readings minus a smooth curve of load and time fitted to their run, and rejected readings",
        "run* step* channel* branch residual sigma unit weight rejected reason",
        optional="decision geometry geometry_sigma",
    ),
    parquet(
        "run_terms",
        "zero and drift of every run and channel, relative to which displacements are counted",
        "run* channel* term* value sigma unit p_value",
    ),
    parquet(
        "exclusions",
        "number of raw rows left out, with the reason",
        "stage subject reason rows by",
    ),
    parquet(
        "exclusion_effects",
        "effect of each [[exclude]]: rows left out, those among them that are gross errors anyway, and the largest "
        "change of a result without the exclusion",
        "entry* subject* by decided_on reason rows gross_anyway largest_change unit over_sigma",
    ),
    parquet(
        "relabelled",
        "targets with another name in the files in some poses, or with a new position after a later survey",
        "body called target from_pose to_pose rows reason",
    ),
    parquet(
        "likely_names",
        "names that no survey has, at the position of a target missing there: a suggestion, never applied",
        "body called target from_pose to_pose rows distance_mm",
    ),
    parquet(
        "resurveys",
        "positions of the targets in a later survey minus their earlier ones, in the frame of the first survey",
        f"later_survey* body* target* shift_x_mm shift_y_mm shift_z_mm {SIGMA} p_value relocated holds_as from_pose "
        "status",
    ),
    parquet(
        "qa",
        "results of all quality checks, one row per check and subject",
        "check subject value limit unit verdict message",
        optional="accepted",
    ),
    parquet(
        "belonging",
        "one row per tested relation between parts of the campaign, with the slips (recording mistakes) that explain "
        "the data",
        "relation subject state reason_code misfit misfit_explained limit unit slips rivals hidden_slips tried "
        "accepted",
    ),
    parquet(
        "poses",
        "rigid-body poses by every estimator, with covariance",
        f"pose* body* parent* method* default {PLACE} {COVARIANCE} rms_mm n_used n_rejected status",
    ),
    parquet(
        "residuals",
        "measured minus fitted points, in the body frame, by the default estimator",
        "pose* body* target* dx_mm dy_mm dz_mm weight rejected reason",
        optional="decision",
    ),
)


_ACCURACY_PARTS = "dx_um dy_um dz_um rx_arcsec ry_arcsec rz_arcsec"
_ACCURACY_NOISE = "position_noise_um orientation_noise_arcsec"

_CALIBRATION = (
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
        "joint_curves",
        "error curves of joints that the extended model holds: motion minus reading, along the reading",
        "joint* joint_reading_si* deviation_si deviation_sigma_si is_determined",
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
        f"row_order* {_WRENCH} {_WRENCH_SIGMA} {_WRENCH_COVARIANCE} is_within",
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

_DIAGNOSIS = (
    parquet(
        "diagnosis",
        "one row per candidate cause",
        "rank* cause verdict subject p_value probability parameters follows rms_before rms_after heldout_rms_before "
        "heldout_rms_after noise_floor unit explanation next_measurement",
        optional="signal_to_noise share_explained share_predicted log_evidence scale_holds reason_code rival settings "
        "clause largest_motion advice_kind next_in_short next_purpose relation left_out_by left_out_blocks "
        "left_out_gain in_model rms_without_any heldout_rms_without_any",
    ),
    parquet(
        "determined_combinations",
        "combinations of the parameters that the data determine, the best determined first, for each accepted cause of "
        "which no single parameter differs significantly from zero",
        "cause* subject* determined* coefficients combined_value combined_sigma unit",
    ),
    parquet(
        "adequacy",
        "tests of the final model's residuals against plain noise, with corrected p-values; how the search for causes "
        "ended, and after how many",
        "subject* test* along* value p_value limit state",
        optional="search_end left_cause left_subject why_untested",
    ),
    Artifact("model", "model.toml", "extended model: nominal and identified parameters, accepted effects"),
    parquet(
        "diagnosis_choices",
        "causes that campaign.toml applies or ignores, and the outcome of each",
        "cause* asked outcome",
    ),
    Artifact(
        "applied_model",
        "applied_model.toml",
        "extended model with the applied causes only, if campaign.toml applies some of the findings",
    ),
    parquet(
        "detectable",
        "smallest size of each cause that the campaign would have shown",
        "cause* subject* parameter* size unit* power",
    ),
    parquet(
        "pulls",
        "pulls of the geometry against its tolerances, before and after the extension",
        "leg* parameter* pull_before pull_after identifiable offset_after explained_after unit",
    ),
    parquet(
        "pull_sums",
        "chi-square of all pulls, with the interval that correct tolerances allow",
        "model* chi_square freedom lower upper p_value",
    ),
    parquet(
        "prediction",
        "measured minus predicted at every pose, without and with the causes that were found; rms_nominal: of a chain "
        "as its description has it, base and tool fitted",
        "pose* role rms_before rms_after largest_before largest_after unit",
        optional="rms_nominal",
    ),
    parquet(
        "component_errors",
        "measured minus predicted by the extended model, by component of [requirement]: the tip of an open chain in "
        "base axes, or an axis by its outside instrument (else its outer encoder); missed_before: without correction, "
        "minus a constant",
        "pose* role component* missed sigma unit",
        optional="missed_before",
    ),
    parquet(
        "reading_errors",
        "measured minus predicted of every reading, after one zero per run, without and with the causes that were "
        "found",
        "run* step* channel* role missed_before missed_after unit",
        optional="noise_floor",
    ),
    parquet(
        "axis_errors",
        "recorded minus predicted of every encoder of an axis, without and with the causes that were found",
        "pose* role encoder* command command_unit approach missed_before missed_after noise_floor unit",
    ),
    parquet(
        "axis_prediction",
        "predicted encoder readings of an axis at a command by its extended model, with one standard deviation",
        "pose* encoder* command command_unit approach value sigma",
    ),
    parquet(
        "next_poses",
        "configurations to measure next, and their purpose",
        "purpose* pose* expected",
        optional=f"{_PLANNED} times conditions temperature_c",
        families="rho",
        covariates=True,
    ),
    parquet(
        "next_loads",
        "load steps to measure next on a bench, run by run, and their purpose",
        f"purpose* run* step* time_s {_WRENCH} branch channels conditions times expected",
        optional=_PLANNED,
    ),
    parquet(
        "tip_uncertainty",
        "contribution of each source to the uncertainty of the tip's predicted pose in the base, of an open chain",
        "pose body parent quantity unit estimate input_source evaluation contribution degrees_of_freedom",
    ),
    parquet(
        "chain_uncertainty",
        "contribution of each source to the uncertainty of the identified numbers of a chain",
        "joint parameter unit input_source evaluation contribution degrees_of_freedom",
    ),
    parquet(
        "cause_uncertainty",
        "contribution of each source to the uncertainty of every parameter of the causes that were found",
        "cause subject parameter input_source evaluation contribution degrees_of_freedom unit",
    ),
    parquet(
        "diagnosis_left_out",
        "points and readings that the diagnosis rejected as gross errors: residual over noise; limit: that of a "
        "target with ordinary scatter, a noisier target has a larger one",
        "subject reason value limit unit",
        optional="pose run step",
    ),
    parquet(
        "calibration_left_out",
        "poses, single legs of poses, and signals at load steps, that the calibration rejected because they disagree "
        "with all others",
        "subject* reason value limit unit",
        optional="pose* run* step*",
    ),
    parquet(
        "calibration_kept",
        "signals at load steps that look like gross errors, and that the calibration uses because they are an effect "
        "of loads or runs: deviation over noise",
        "subject kept_because shared_input value unit p_value",
        optional="run step",
    ),
    Artifact("start", "start.toml", "model of an earlier campaign, used as the start of this one"),
    parquet(
        "changes",
        "changes since the earlier campaign that this one starts from",
        "leg parameter effect_of unit before sigma_before now sigma_now sigma_difference z changed change "
        "sigma_change instead",
    ),
    parquet(
        "compared",
        "numbers of several runs of one machine, each against the previous run (`truing compare`)",
        "place* folder campaign group* effect_of* leg* parameter* value sigma unit difference sigma_difference z "
        "changed change sigma_change instead reason",
    ),
    parquet(
        "campaigns",
        "all campaigns of one call of `truing run`, the worst first",
        "rank* campaign campaign_path campaign_state decided_by explanation exit_code failed_checks problems problem "
        "run_folder stages_run processor_s",
    ),
    parquet(
        "verdict",
        "one row per section of the report, and one of the whole campaign with the worst section that needs action",
        "section* state reason_code value unit limit explanation",
        optional="decided_by",
    ),
    parquet(
        "next_measurements",
        "all proposed measurements in words, the most urgent first; their configurations and loads are in next_poses "
        "and next_loads",
        "rank* need purpose next_measurement",
        optional="measurements duration_s sigma_now sigma_expected odds_expected unit",
    ),
    Artifact("report", "report.html", "the report as a page: measurements, findings and rejected data"),
)

ARTIFACTS: dict[str, Artifact] = {
    artifact.name: artifact for artifact in (*_MEASUREMENT, *PHOTOGRAPHS, *_CALIBRATION, *_DIAGNOSIS)
}
