"""Stage diagnose: effects that the simulation lacks, their causes, and the extended model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.schemas.mechanism import (
    COLUMNS_OF_AXES,
    NOISE_OF_COMMANDS,
    NOISE_OF_ENCODERS,
    NOISE_OF_JOINTS,
    OF_CHAINS,
)
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.campaign import Campaign

_POINTS = ("observations?", "survey?", "configurations?", "poses?", "residuals?")
_LOADS = ("readings?", "signals?", "given_compliance?", "positions?")
_RAYS = ("ray_statistics?", "ray_information?", "ray_effects?", "point_correlations?", "object_points?", "scale_bars?")
_MECHANISM = (
    *("type", "legs", "tolerance", "reference_temperature_c", "actuator_pitch_mm", "payload_kg", "payload_com_mm"),
    *("height_mm", "elements", "platform", "base"),
)
_NOISE = ("point_mm", "actuator_mm", "signal_mv", "load_n", "load_nm")
_SECTIONS = ("loading", "interferometer", "signals", "bodies", "workspace", "exclude", "keep")
_RULES = ("false_alarm", "seed", "apply", "ignore")
_WHY_SINGULAR = {  # by whether the mechanism has legs
    True: "the equations of a fit have no single solution: at a tested size of some effect the legs are out of reach "
    "or hold the platform in no single place",
    False: "the equations of the fit have no single solution: a quantity is not determined by these data, or a "
    "declared noise is far smaller than the others",
}

DECLARATION = Stage(
    name="diagnose",
    reads=(*_POINTS, "joints?", "distances?", "measured_poses?", "start?", *_LOADS, "qa?", *_RAYS),
    leaves=(
        *("diagnosis", "adequacy?", "model?", "detectable?", "pulls?", "pull_sums?"),
        *("prediction?", "reading_errors?", "axis_errors?", "chain_parameters?", "series_errors?", "arm_accuracy?"),
        *("component_errors?", "tip_uncertainty?", "chain_uncertainty?", "chain_inseparable?"),
        "motor_encoders?",
        *("joint_curves?", "guideway_errors?"),
        *("next_poses?", "next_loads?", "changes?", "cause_uncertainty?", "determined_combinations?"),
        "diagnosis_left_out?",
        *("diagnosis_choices?", "applied_model?"),
    ),
    settings=(
        *(f"campaign.{key}" for key in ("name", "kind", "drives")),
        *(f"mechanism.{key}" for key in _MECHANISM),
        *(f"noise.{key}" for key in _NOISE),
        *(*COLUMNS_OF_AXES, *NOISE_OF_COMMANDS, *NOISE_OF_ENCODERS, *NOISE_OF_JOINTS),
        *(key for key in OF_CHAINS if key.removeprefix("mechanism.") not in _MECHANISM),
        *(f"diagnosis.{key}" for key in _RULES),
        *("measurement.up", "measurement.frame", *_SECTIONS),
    ),
    summary="what the simulation gets wrong: causes, their sizes, the extended model",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Search the catalogue for causes of the campaign's departure from its simulation."""
    import numpy as np

    from truing.stages.common.approaches import axis_of_approaches, has_only_approaches
    from truing.stages.common.belonging import reason_withheld
    from truing.stages.diagnosis.artifacts import not_evaluated, outcome, outcome_of_rays
    from truing.stages.diagnosis.noise_of_signals import with_noise_next_to_causes
    from truing.stages.diagnosis.ray_findings import corrected, ray_findings, with_shared_errors
    from truing.stages.diagnosis.ray_points import has_rays
    from truing.stages.diagnosis.search import assembled_data, search_causes

    if why := reason_withheld(tables):
        return not_evaluated(why, settings)
    rays = ray_findings(tables, settings, progress) if has_rays(tables) else None
    try:
        if has_only_approaches(tables):
            tables, settings = axis_of_approaches(tables, settings)
        data = assembled_data(tables if rays is None else corrected(tables, rays), settings)
    except ValueError as error:
        return not_evaluated(str(error), settings) if rays is None else outcome_of_rays(rays, str(error), settings)
    try:
        if rays is not None:
            data = with_shared_errors(data, tables, rays)
        diagnosis = search_causes(data, settings, progress)
        if (quieter := with_noise_next_to_causes(diagnosis, data)) is not None:
            data, diagnosis = quieter, search_causes(quieter, settings, progress)
        progress(0, 1, "detectable sizes, and next measurements")
        return outcome(diagnosis, data, rays, settings)
    except np.linalg.LinAlgError:
        return not_evaluated(_WHY_SINGULAR[settings.mechanism.is_legged], settings)
