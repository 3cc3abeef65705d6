"""Every artifact of a run by name: what was measured, the models fitted to it, the diagnosis and the page."""

from __future__ import annotations

from itertools import combinations

from truing.schemas.artifact import Artifact, parquet
from truing.schemas.photograph_artifacts import CORRELATION, COVARIANCE, PHOTOGRAPHS, PLACE, POINT, SIGMA

_WRENCH = "fx_n fy_n fz_n mx_nm my_nm mz_nm"
_WRENCH_SIGMA = " ".join(f"sigma_{name}" for name in _WRENCH.split())
_WRENCH_COVARIANCE = " ".join(f"cov_{a}_{b}" for a, b in combinations(("fx", "fy", "fz", "mx", "my", "mz"), 2))
_SURROUNDINGS = "air_temperature_c air_pressure_hpa relative_humidity_pct material_temperature_c"

# Of what to measure next: what it serves, how much it takes, and what it gives.
_PLANNED = "need measurements duration_s sigma_now sigma_expected unit odds_expected repeat_of"

_MEASUREMENT = (
    parquet(
        "observations",
        "normalised object points, one row per pose, body and target",
        f"pose* body* target* {POINT} {SIGMA}",
        optional=f"{CORRELATION} point",
    ),
    parquet(
        "survey",
        "the reference survey of the targets, in each body's own frame",
        f"body* target* {POINT} {SIGMA} leg",
        optional=CORRELATION,
    ),
    parquet(
        "measured_poses",
        "poses as the instrument gave them, in the frame of the measurement, with their declared covariance",
        f"pose* body* {PLACE} {COVARIANCE}",
    ),
    parquet(
        "scans",
        "where a dense scan of a body's surface lays the body, in the frame of the measurement",
        f"pose* body* {PLACE} {COVARIANCE} rms_mm n_used n_rejected overlap noise_ratio status message",
    ),
    parquet(
        "configurations",
        "one row per pose: role, time, actuator readings, covariates",
        "pose* role time_s",
        optional="temperature_c repeat_of event",
        families="rho",
        covariates=True,
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
        "quadrature",
        "raw signals of an interferometer: the ellipse of every channel, and what it leaves",
        "channel* samples x0 y0 amplitude_x amplitude_y lag_rad radius_before radius_after radius_uncut radius_mean "
        "cut_share periodic_error_um miscount_risk status",
        optional="sigma_source",
    ),
    parquet(
        "reading_corrections",
        "what was corrected in readings for air and material, and what the correction leaves uncertain, at most",
        "subject* correction* largest sigma unit",
    ),
    parquet(
        "positions",
        "where an axis stood at its targets, one row per approach",
        "run* target_mm* direction* cycle* position_mm",
        optional=f"{_SURROUNDINGS} position_read_mm row_order",
    ),
    parquet(
        "given_compliance",
        "the simulated compliance that the campaign's compliance_file gives, SI",
        "response* load* coefficient unit",
    ),
    parquet(
        "displacement",
        "displacement of the platform per load case, zeros and drift of the runs taken out; empty where never measured",
        f"case* branch {_WRENCH} dx_mm dy_mm dz_mm rx_rad ry_rad rz_rad {COVARIANCE} n_used n_rejected",
        optional="role",
        version=2,
    ),
    parquet(
        "reading_residuals",
        "readings less their run's own smooth curve of load and time, and what was kept out",
        "run* step* channel* branch residual sigma unit weight rejected reason",
        optional="decision geometry geometry_sigma",
    ),
    parquet(
        "run_terms",
        "zero and drift of every run and channel, as the displacement is counted from",
        "run* channel* term* value sigma unit p_value",
    ),
    parquet(
        "exclusions",
        "raw rows that were read and left out, counted, with the reason",
        "stage subject reason rows by",
    ),
    parquet(
        "exclusion_effects",
        "what each [[exclude]] left out, how much of it is a gross error all the same, and by how much poses or "
        "displacements would change at most if all were taken back",
        "entry* subject* by decided_on reason rows gross_anyway largest_change unit over_sigma",
    ),
    parquet(
        "relabelled",
        "targets that the files call otherwise in some poses, or that a later survey found elsewhere, and in how many "
        "points",
        "body called target from_pose to_pose rows reason",
    ),
    parquet(
        "likely_names",
        "names that no survey knows, at the place of a target that is not seen with them: a suggestion, never applied",
        "body called target from_pose to_pose rows distance_mm",
    ),
    parquet(
        "resurveys",
        "where a later survey has the targets, in the frame of the first, less where they were before",
        f"later_survey* body* target* shift_x_mm shift_y_mm shift_z_mm {SIGMA} p_value relocated holds_as from_pose "
        "status",
    ),
    parquet(
        "qa",
        "one row per check",
        "check subject value limit unit verdict message",
        optional="accepted",
    ),
    parquet(
        "belonging",
        "one row per tested relation between parts of the campaign, with the slips of the hand that explain the data",
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
        "measured minus fitted, in the body frame, by the default estimator",
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
        "shift of each target in its body frame, where no mechanism says what drives it",
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
        "error figures of each deformation model",
        "model leg figure value unit",
        optional="subject",
    ),
    parquet(
        "compliance",
        "displacement per load, entry by entry: by each model as far as it is known, and simulated",
        "model* response* load* coefficient sigma unit",
        optional="p_value significant simulated simulated_sigma pull verdict",
    ),
    parquet(
        "positioning",
        "positioning of an axis by ISO 230-2: quantities of each target, and of the axis (empty subject)",
        "run* figure* subject* value unit",
        optional="sigma low high",
    ),
    parquet(
        "axis_curves",
        "displacement against load of the load cases along one axis alone: measured, and simulated where that is known",
        "load* channel* case* branch applied measured sigma unit",
        optional="simulated simulated_sigma",
    ),
    parquet(
        "calibration",
        "parameters identified by errors in variables, tolerances as prior; and those of the extended model",
        "model* deformation* leg* parameter* unit nominal identified sigma tolerance pull identifiable status",
        optional="effect_of*",
    ),
    parquet(
        "implicit_calibration",
        "the same by least squares on the closure alone, as the telescope report does (eq. 30-33)",
        "model* deformation* leg* parameter* unit nominal identified sigma tolerance pull identifiable status",
    ),
    parquet(
        "correlations",
        "correlated pairs of identified parameters in calibration.parquet, |correlation| of 0.05 and more",
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
        "the same for every model of implicit_calibration.parquet",
        "model* deformation* pose* role position_error_um orientation_error_arcsec",
        optional=f"{_ACCURACY_PARTS} {_ACCURACY_NOISE}",
    ),
    parquet(
        "repeats",
        "what was measured more than once: its scatter (pure error) with its 95 % interval, against what is stated",
        "repeated* subject* pure_error lower upper declared_sigma unit freedom_of_error groups told_by",
        optional="p_equal",
    ),
    parquet(
        "pose_repeatability",
        "repeatability at every pose that was repeated, of bodies and single reflectors: sigma of a coordinate, RP and "
        "RP_a to RP_c of ISO 9283 with intervals of 95 %; pose: the first of its group",
        "subject* pose* figure* value low high unit attained told_by",
    ),
    parquet(
        "lack_of_fit",
        "the F test of what each model leaves against pure error, subject by subject",
        "repeated* contender* subject* f_ratio freedom_of_fit freedom_of_error p_value",
    ),
    parquet(
        "model_choice",
        "figures of every calibration, by which one is chosen",
        "model* deformation* estimator* figure* value unit",
    ),
    parquet(
        "observability",
        "what the data can know of the parameters: rank, indices, and what cannot be told apart",
        "model deformation leg figure value unit combination",
    ),
    parquet(
        "absorption",
        "which parameters swallow an effect that the model leaves out: predicted, and what the fit did",
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
        "figures of merit of these matrices, moments as they are (length 1 m) and over a characteristic length",
        "matrix model length_m figure value sigma unit",
        optional="subject",
    ),
    parquet(
        "sensor_choice",
        "figures of every calibration of a force sensor, by which one is chosen; and why others could not be made",
        "model figure value unit",
        optional="subject reason",
    ),
    Artifact("sensor", "sensor.toml", "the chosen calibration of a force sensor, from which signals give the wrench"),
    parquet(
        "wrenches",
        "the wrench that each row of signals tells by the chosen calibration, with its covariance",
        f"row_order* {_WRENCH} {_WRENCH_SIGMA} {_WRENCH_COVARIANCE} is_within",
        optional="run step time_s",
    ),
    parquet(
        "calibrations_compared",
        "held-out errors of the calibration of the data as recorded and of the one with findings applied; one of them "
        "is the main one, which all other tables tell of",
        "data* is_main findings model quantity* tested_on* rms_error largest_error rms_unchanged count unit",
        optional="deformation noise_rms",
    ),
    parquet(
        "second_campaign_errors",
        "errors of a second campaign of the same machine as models predict it that were fitted to this one: nominal, "
        "calibrated, and extended with what the diagnosis found, as far as it lasts",
        "campaign prediction_by* model quantity* rms_error largest_error noise_rms count unit",
    ),
    parquet(
        "error_classes",
        "errors of the calibrated sensor as laboratories report them, per axis; empty, with the reason, where not told",
        "error_class* load* indicated* value sigma limit unit",
        optional="applied reason",
    ),
    parquet(
        "requirements",
        "the accuracy asked for against the accuracy reached",
        "model* deformation* component* requirement error lower upper unit verdict message",
        optional="poses_judged measurements lower_expected upper_expected",
    ),
    parquet(
        "uncertainty",
        "statement of uncertainty: every result that is quoted, with its standard and its expanded uncertainty",
        "result* subject* quantity* estimate standard_uncertainty degrees_of_freedom coverage_factor "
        "expanded_uncertainty unit stated reason",
    ),
    parquet(
        "uncertainty_budget",
        "what each source gives to these uncertainties; and what is no part of them, with the reason",
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
        "left_out_gain",
    ),
    parquet(
        "adequacy",
        "whether the final model holds as a whole: what it leaves, tested against plain noise; p-values are corrected "
        "for the number of tests; whether the search for causes came to its end, after how many accepted causes",
        "subject* test* along* value p_value limit state",
        optional="search_end left_cause left_subject why_untested",
    ),
    Artifact("model", "model.toml", "the extended model: nominal, identified parameters, accepted effects"),
    parquet(
        "diagnosis_choices",
        "causes that campaign.toml asks to apply or to ignore, and what became of each",
        "cause* asked outcome",
    ),
    Artifact(
        "applied_model",
        "applied_model.toml",
        "the extended model with the applied causes alone, where campaign.toml applies only some of those found",
    ),
    parquet(
        "detectable",
        "the smallest size of each cause that the campaign would have shown",
        "cause* subject* parameter* size unit* power",
    ),
    parquet(
        "pulls",
        "how far the geometry moved from where it was built, before and after the extension",
        "leg* parameter* pull_before pull_after identifiable",
    ),
    parquet(
        "pull_sums",
        "all pulls together, against what honest tolerances let them be",
        "model* chi_square freedom lower upper p_value",
    ),
    parquet(
        "prediction",
        "measured minus predicted at every pose, without and with the causes that were found",
        "pose* role rms_before rms_after largest_before largest_after unit",
    ),
    parquet(
        "reading_errors",
        "measured minus predicted of every reading, less one zero per run, without and with the causes that were found",
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
        "what an axis' encoders read at a command by its extended model, with one standard deviation",
        "pose* encoder* command command_unit approach value sigma",
    ),
    parquet(
        "next_poses",
        "what to measure next: configurations, and what they are for",
        "purpose* pose* expected",
        optional=f"{_PLANNED} times conditions temperature_c",
        families="rho",
        covariates=True,
    ),
    parquet(
        "next_loads",
        "what to measure next on a bench: load steps, run by run, and what they are for",
        f"purpose* run* step* time_s {_WRENCH} branch channels conditions times expected",
        optional=_PLANNED,
    ),
    parquet(
        "cause_uncertainty",
        "what each source gives to the uncertainty of every number of the causes that were found",
        "cause subject parameter input_source evaluation contribution degrees_of_freedom unit",
    ),
    parquet(
        "diagnosis_left_out",
        "points and readings that the diagnosis took out as gross errors: their residuals over their noise; limit: "
        "that of a target of ordinary spread, one that scatters more has a larger one",
        "subject reason value limit unit",
        optional="pose run step",
    ),
    parquet(
        "calibration_left_out",
        "poses, and poses of single legs, that the calibration took out because they disagree with all others",
        "pose* subject* reason value limit unit",
    ),
    Artifact("start", "start.toml", "the model of an earlier campaign that this one starts from"),
    parquet(
        "changes",
        "what has changed since the campaign that this one starts from",
        "leg parameter effect_of unit before sigma_before now sigma_now sigma_difference z changed change "
        "sigma_change instead",
    ),
    parquet(
        "compared",
        "numbers of several runs of one machine, each against the run before (`truing compare`)",
        "place* folder campaign group* effect_of* leg* parameter* value sigma unit difference sigma_difference z "
        "changed change sigma_change instead reason",
    ),
    parquet(
        "verdict",
        "one row per section of the page, and one of the whole campaign, led by the worst that a reader must act on",
        "section* state reason_code value unit limit explanation",
        optional="decided_by",
    ),
    parquet(
        "next_measurements",
        "all that could be measured next, the most urgent need first, in words; configurations and loads stand in "
        "next_poses and next_loads",
        "rank* need purpose next_measurement",
        optional="measurements duration_s sigma_now sigma_expected odds_expected unit",
    ),
    Artifact("report", "report.html", "the page: what was measured, found and left out"),
)

ARTIFACTS: dict[str, Artifact] = {
    artifact.name: artifact for artifact in (*_MEASUREMENT, *PHOTOGRAPHS, *_CALIBRATION, *_DIAGNOSIS)
}
