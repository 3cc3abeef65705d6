"""Calibration: the machine's numbers under every model of its structure, what data can know, how accurate it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from truing.report.numbers import count as counted
from truing.schemas.artifacts import ARTIFACTS
from truing.stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.calibration.extended import Extended
    from truing.calibration.measured import Gathered
    from truing.schemas.campaign import Campaign
    from truing.stages.common.rows import Rows

LEAST_MOVEMENT = 10.0  # of the platform, in sigmas of its place, below which nothing was asked of the machine
LEAST_LEGS = 6  # with fewer, readings leave the platform free

OF_MECHANISM = (
    "calibration",
    "implicit_calibration",
    "correlations",
    "accuracy",
    "implicit_accuracy",
    "model_choice",
    "observability",
    "absorption",
    "requirements",
)

DECLARATION = Stage(
    name="calibrate",
    reads=(
        "observations?",
        "configurations?",
        "survey?",
        "poses?",
        "residuals?",
        "deformation?",
        "deformation_models?",
        "model?",
        "readings?",
        "signals?",
        "displacement?",
        "given_compliance?",
        "diagnosis?",
        "reading_errors?",
        *("pose_sensitivities?", "pose_covariances?", "camera_correlations?"),
        *("shift_covariances?", "shift_sensitivities?", "survey_covariances?"),
        "qa?",
    ),
    leaves=(
        *(f"{name}?" for name in OF_MECHANISM),
        "sensor_matrix?",
        "sensor_merit?",
        "sensor_choice?",
        "error_classes?",
        "repeats?",
        "lack_of_fit?",
        "pose_repeatability?",
        "calibration_left_out?",
    ),
    settings=(
        "campaign.kind",
        "campaign.drives",
        "measurement.frame",
        "mechanism.type",
        "mechanism.legs",
        "mechanism.tolerance",
        "mechanism.flexure",
        "mechanism.leg_tube",
        "mechanism.height_mm",
        "mechanism.elements",
        "mechanism.reference_temperature_c",
        "loading",
        "signals",
        "noise.point_mm",
        "noise.actuator_mm",
        "noise.signal_mv",
        "noise.load_n",
        "noise.load_nm",
        "requirement",
        "exclude",
        "keep",
    ),
    summary="kinematic and stiffness models identified, with what the data can know of them",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Calibrate every model that the mechanism's numbers allow, choose among them, and hold them against repeats."""
    from truing.stages.common.belonging import withheld

    if why := withheld(tables):
        return _of_nothing(why, settings)
    found = _calibrated(tables, settings, progress)
    known = {name: table for name, table in found.artifacts.items() if hasattr(table, "num_rows")}
    named = "string" if _pose_names(tables) else "int64"
    told = {rows.artifact: rows.table(named) for rows in _repeats({**tables, **known}, settings) if rows.count}
    return replace(found, artifacts={**found.artifacts, **told})


def _repeats(tables: Mapping[str, pa.Table], settings: Campaign) -> tuple[Rows, ...]:
    """What was measured more than once, by table."""
    if settings.campaign.kind == "interferometer":
        from truing.stages.repeats.of_loads import repeats_of_loads

        return repeats_of_loads(tables, settings)
    from truing.stages.repeats.of_poses import repeats_of_poses

    return repeats_of_poses(tables, settings)


def _pose_names(tables: Mapping[str, pa.Table]) -> bool:
    """Whether poses have names in place of numbers."""
    return "configurations" in tables and str(tables["configurations"].schema.field("pose").type) == "string"


def _calibrated(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Calibrate every model that the mechanism's numbers allow, and choose among them."""
    if settings.campaign.kind == "interferometer":
        from truing.stages.sensor_calibration.run import calibrate_sensor

        return calibrate_sensor(tables, settings, progress)
    from truing.stages.common.why_not import why_no_calibration

    if why := why_no_calibration(settings.mechanism, tables):
        return not_evaluated(why)
    from truing.stages.calibration.run import NothingCalibrated, calibrate
    from truing.stages.common.calibration_data import gather

    try:
        gathered = gather(tables, settings)
    except ValueError as why:
        return not_evaluated(str(why))
    if little := _too_little(gathered):
        return not_evaluated(little)
    if unreached := _unreached(gathered):
        return not_evaluated(unreached)
    try:
        return calibrate(gathered, settings.requirement, _extended(tables, gathered), progress)
    except NothingCalibrated as why:
        return not_evaluated(str(why))


def _extended(tables: Mapping[str, pa.Table], gathered: Gathered) -> Extended | None:
    """The extended model that the diagnosis left; None where it left none."""
    from truing.stages.calibration.extended import extended_of

    text = tables.get("model")
    if not isinstance(text, str):
        return None
    return extended_of(text, tables, gathered.measured, gathered.measured.roles != "verification")


def _too_little(gathered: Gathered) -> str:
    """Why these poses say too little of any machine; empty where they do not."""
    import numpy as np

    from truing.estimation.rotation import log_so3
    from truing.stages.common.why_not import why_too_few_poses

    fitted = int(np.sum(gathered.measured.roles != "verification"))
    if few := why_too_few_poses(fitted):
        return few
    platform = gathered.measured.platform
    away = np.concatenate([platform.p - platform.p[0], log_so3(platform.R @ platform.R[0].T)], -1)
    noise = np.sqrt(np.diagonal(platform.covariance, axis1=1, axis2=2).mean(0))
    if np.all(np.ptp(away, axis=0) <= LEAST_MOVEMENT * noise):
        return "the platform hardly moved: its poses differ by no more than their noise"
    return ""


def _unreached(gathered: Gathered) -> str:
    """Why the nominal mechanism cannot be calibrated at these readings; empty where it can."""
    import numpy as np

    from truing.simulation.mechanisms.legs.kinematics import inverse, reaches

    legs, rho, platform = gathered.machine.legs, gathered.measured.rho, gathered.measured.platform
    if 2 * np.isfinite(inverse(legs, platform.p, platform.R)).all(1).sum() < len(rho):
        return "the legs of [mechanism] do not reach these poses at any reading"
    if legs.count < LEAST_LEGS:
        return ""
    if not reaches(legs, legs.rho0[None]).all():
        return "the legs of [mechanism] cannot meet the platform at their reference readings"
    count = int((~reaches(legs, rho)).sum())
    if 2 * count > len(rho):
        return (
            f"the legs of [mechanism] cannot meet the platform at the readings of {count} of "
            f"{counted(len(rho), 'pose')}"
        )
    return ""


def _of_nothing(why: str, settings: Campaign) -> Outcome:
    """The outcome of a campaign of either kind whose data cannot be used."""
    if settings.campaign.kind != "interferometer":
        return not_evaluated(why)
    from truing.stages.sensor_calibration.run import nothing

    return nothing(why)


def not_evaluated(why: str) -> Outcome:
    """The outcome of a campaign that does not hold what this stage needs."""
    empty = {name: ARTIFACTS[name].empty() for name in OF_MECHANISM}
    return Outcome.not_evaluated(empty, why)
