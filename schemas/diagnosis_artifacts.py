"""What is left of the diagnosis: causes, the extended model, what it gains, what to measure next; and the page."""

from __future__ import annotations

from truing.schemas.artifact import Artifact, parquet

_WRENCH = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")

DIAGNOSIS = (
    parquet(
        "diagnosis",
        "one row per candidate cause",
        (
            "rank",
            "cause",
            "verdict",
            "subject",
            "p_value",
            "probability",
            "parameters",
            "follows",
            "rms_before",
            "rms_after",
            "heldout_rms_before",
            "heldout_rms_after",
            "noise_floor",
            "unit",
            "explanation",
            "next_measurement",
        ),
        optional=(
            *("signal_to_noise", "log_evidence", "scale_holds", "reason_code", "rival", "settings", "clause"),
            *("largest_motion", "advice_kind", "next_in_short"),
        ),
        key=("rank",),
    ),
    Artifact("model", "model.toml", "the extended model: nominal, identified parameters, accepted effects"),
    parquet(
        "detectable",
        "the smallest size of each cause that the campaign would have shown",
        ("cause", "subject", "parameter", "size", "unit", "power"),
        key=("cause", "subject", "parameter", "unit"),
    ),
    parquet(
        "pulls",
        "how far the geometry moved from where it was built, before and after the extension",
        ("leg", "parameter", "pull_before", "pull_after", "identifiable"),
        key=("leg", "parameter"),
    ),
    parquet(
        "pull_sums",
        "all pulls together, against what honest tolerances let them be",
        ("model", "chi_square", "freedom", "lower", "upper", "p_value"),
        key=("model",),
    ),
    parquet(
        "prediction",
        "measured minus predicted at every pose, without and with the causes that were found",
        ("pose", "role", "rms_before", "rms_after", "largest_before", "largest_after", "unit"),
        key=("pose",),
    ),
    parquet(
        "reading_errors",
        "measured minus predicted of every reading, less one zero per run, without and with the causes that were found",
        ("run", "step", "channel", "role", "missed_before", "missed_after", "unit"),
        optional=("noise_floor",),
        key=("run", "step", "channel"),
    ),
    parquet(
        "axis_errors",
        "recorded minus predicted of every encoder of an axis, without and with the causes that were found",
        (
            *("pose", "role", "encoder", "command", "command_unit", "approach"),
            *("missed_before", "missed_after", "noise_floor", "unit"),
        ),
        key=("pose", "encoder"),
    ),
    parquet(
        "axis_prediction",
        "what an axis' encoders read at a command by its extended model, with one standard deviation",
        ("pose", "encoder", "command", "command_unit", "approach", "value", "sigma"),
        key=("pose", "encoder"),
    ),
    parquet(
        "next_poses",
        "what to measure next: configurations, and what they are for",
        ("purpose", "pose", "expected"),
        optional=("times", "conditions", "temperature_c"),
        families=("rho",),
        covariates=True,
        key=("purpose", "pose"),
    ),
    parquet(
        "next_loads",
        "what to measure next on a bench: load steps, run by run, and what they are for",
        ("purpose", "run", "step", "time_s", *_WRENCH, "branch", "channels", "conditions", "times", "expected"),
        key=("purpose", "run", "step"),
    ),
    parquet(
        "cause_uncertainty",
        "what each source gives to the uncertainty of every number of the causes that were found",
        ("cause", "subject", "parameter", "input_source", "evaluation", "contribution", "degrees_of_freedom", "unit"),
    ),
    parquet(
        "diagnosis_left_out",
        "points and readings that the diagnosis took out as gross errors: their residuals over their noise; limit: "
        "that of a target of ordinary spread, one that scatters more has a larger one",
        ("subject", "reason", "value", "limit", "unit"),
        optional=("pose", "run", "step"),
    ),
    parquet(
        "calibration_left_out",
        "poses, and poses of single legs, that the calibration took out because they disagree with all others",
        ("pose", "subject", "reason", "value", "limit", "unit"),
        key=("pose", "subject"),
    ),
    Artifact("start", "start.toml", "the model of an earlier campaign that this one starts from"),
    parquet(
        "changes",
        "what has changed since the campaign that this one starts from",
        (
            "leg",
            "parameter",
            "effect_of",
            "unit",
            "before",
            "sigma_before",
            "now",
            "sigma_now",
            "sigma_difference",
            "z",
            "changed",
            "change",
            "sigma_change",
            "instead",
        ),
    ),
    Artifact(
        "compared",
        "compared.parquet",
        "numbers of several runs of one machine, each against the run before (`truing compare`)",
        (
            *("place", "folder", "campaign", "group", "effect_of", "leg", "parameter", "value", "sigma", "unit"),
            *("difference", "sigma_difference", "z", "changed", "change", "sigma_change", "instead", "reason"),
        ),
        key=("place", "group", "effect_of", "leg", "parameter"),
    ),
    Artifact("report", "report.html", "the page: what was measured, found and left out"),
)
