"""Artifacts of the diagnosis, the extended model, the next measurements, the comparison of runs and the report."""

from __future__ import annotations

from truing.schemas.artifact import Artifact, parquet
from truing.schemas.measured_artifacts import WRENCH

# Columns on what to measure next: need, effort and expected gain.
_PLANNED = "need measurements duration_s sigma_now sigma_expected unit odds_expected repeat_of"

DIAGNOSIS = (
    parquet(
        "diagnosis",
        "one row per candidate cause",
        "rank* cause verdict subject p_value probability parameters follows rms_before rms_after heldout_rms_before "
        "heldout_rms_after noise_floor unit explanation next_measurement",
        optional="signal_to_noise share_explained share_predicted log_evidence scale_holds reason_code rival settings "
        "clause largest_motion advice_kind next_in_short next_purpose relation left_out_by left_out_blocks "
        "left_out_gain in_model rms_without_any heldout_rms_without_any heldout_growth",
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
        "as its description has it, base and tool fitted; sigma_of_fit: at held-out poses, by the uncertainty of the "
        "fit alone",
        "pose* role rms_before rms_after largest_before largest_after unit",
        optional="rms_nominal sigma_of_fit p_deviates",
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
        f"purpose* run* step* time_s {WRENCH} branch channels conditions times expected",
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
        optional="pose run step measured_there",
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
