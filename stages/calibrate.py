"""Stage calibrate: parameters of the machine under every model of its structure, observability and accuracy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

DECLARATION = Stage(
    name="calibrate",
    reads=(
        *("observations?", "configurations?", "survey?", "poses?", "residuals?"),
        *("deformation?", "deformation_models?", "model?", "applied_model?", "diagnosis_choices?"),
        *("readings?", "signals?", "displacement?", "given_compliance?", "diagnosis?", "reading_errors?"),
        *("adequacy?", "prediction?", "component_errors?"),
        *("pose_sensitivities?", "pose_covariances?", "camera_correlations?"),
        *("shift_covariances?", "shift_sensitivities?", "survey_covariances?"),
        "qa?",
    ),
    leaves=(
        *("calibration?", "implicit_calibration?", "correlations?", "accuracy?", "implicit_accuracy?"),
        *("model_choice?", "observability?", "absorption?", "requirements?"),
        *("sensor_matrix?", "sensor_merit?", "sensor_choice?", "error_classes?", "sensor?"),
        *("repeats?", "lack_of_fit?", "pose_repeatability?", "calibration_left_out?", "calibration_kept?"),
        *("calibrations_compared?", "flexure_parameters?"),
    ),
    settings=(
        *("campaign.kind", "campaign.drives", "measurement.frame", "mechanism.type", "mechanism.legs"),
        *("mechanism.tolerance", "mechanism.flexure", "mechanism.leg_tube", "mechanism.height_mm"),
        *(
            "mechanism.elements",
            "mechanism.platform",
            "mechanism.base",
            "mechanism.reference_temperature_c",
            "loading",
            "signals",
        ),
        *("noise.point_mm", "noise.actuator_mm", "noise.signal_mv", "noise.load_n", "noise.load_nm"),
        *(
            "mechanism.stiffness_along_motion",
            "load",
            "measurement.up",
            "mechanism.payload_kg",
            "mechanism.payload_com_mm",
        ),
        *("calibration", "requirement", "exclude", "keep"),
    ),
    summary="kinematic and stiffness models identified, with their observability",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Fit every model that the mechanism allows, choose one, and test them against repeats."""
    from truing.stages.common.belonging import reason_withheld

    if settings.campaign.kind == "interferometer":
        from truing.stages.calibration.sensor import calibrate_sensor as calibrated
        from truing.stages.calibration.sensor import outcome_without_sensor as nothing
        from truing.stages.repeats.load_repeats import repeats_of_loads as repeats
    else:
        from truing.stages.calibration.run import calibrate_mechanism as calibrated
        from truing.stages.calibration.run import nothing_calibrated as nothing
        from truing.stages.repeats.pose_repeats import repeats_of_poses as repeats
    if why := reason_withheld(tables):
        return nothing(why)
    outcome = calibrated(tables, settings, progress)
    known = {name: table for name, table in outcome.artifacts.items() if hasattr(table, "num_rows")}
    named = str(tables["configurations"].schema.field("pose").type) if "configurations" in tables else "int64"
    reported = {rows.artifact: rows.table(named) for rows in repeats({**tables, **known}, settings) if rows.count}
    return replace(outcome, artifacts={**outcome.artifacts, **reported})
