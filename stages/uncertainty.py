"""Stage uncertainty: a GUM statement with budget for every reported result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

DECLARATION = Stage(
    name="uncertainty",
    reads=(
        *("observations?", "survey?", "configurations?"),
        *("readings?", "signals?", "reading_corrections?", "positions?", "given_compliance?"),
        *("poses?", "residuals?", "displacement?", "reading_residuals?", "run_terms?"),
        *("deformation?", "deformation_models?", "compliance?", "positioning?"),
        *("diagnosis?", "cause_uncertainty?", "tip_uncertainty?", "model?", "applied_model?", "diagnosis_choices?"),
        *("chain_parameters?", "chain_uncertainty?"),
        *("calibration?", "accuracy?", "model_choice?", "sensor_matrix?"),
        *("pose_sensitivities?", "camera_correlations?", "scale_bar_lengths?"),
        *("pose_covariances?", "shift_covariances?", "shift_sensitivities?", "survey_covariances?"),
    ),
    leaves=("uncertainty", "uncertainty_budget"),
    settings=(
        "campaign.kind",
        "mechanism",
        "loading",
        "interferometer",
        "signals",
        "noise",
        "calibration",
        "load",
        "measurement.up",
        "exclude",
        "keep",
    ),
    summary="standard and expanded uncertainty of every result, with a budget by source",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Write the uncertainty of every result, and a reason for each result without one."""
    from truing.report.numbers import count_text
    from truing.stages.uncertainty_statement.bench import state_compliance, state_sensor
    from truing.stages.uncertainty_statement.causes import state_causes
    from truing.stages.uncertainty_statement.chain import state_chain, state_tip
    from truing.stages.uncertainty_statement.machine import state_accuracy, state_calibration, state_positioning
    from truing.stages.uncertainty_statement.poses import state_poses
    from truing.stages.uncertainty_statement.statement import Statement

    made = Statement()
    of_bench = (state_compliance, state_sensor, state_positioning)
    parts = (
        of_bench
        if settings.campaign.kind == "interferometer"
        else (state_poses, state_calibration, state_chain, state_tip)
    )
    for done, part in enumerate((*parts, state_causes, state_accuracy)):
        progress(done, len(parts) + 2, part.__name__.replace("_", " "))
        part(made, tables, settings)
    artifacts = {"uncertainty": made.stated.table(), "uncertainty_budget": made.parts.table()}
    stated = sum(artifacts["uncertainty"].column("stated").to_pylist())
    left, sources = artifacts["uncertainty"].num_rows - stated, artifacts["uncertainty_budget"].num_rows
    return Outcome(
        artifacts,
        read=f"{len(tables)} artifacts",
        left_out=f"{count_text(left, 'result')} without an uncertainty" if left else "nothing",
        figure=f"{count_text(stated, 'result')} with expanded uncertainty, from {count_text(sources, 'contribution')}",
    )
