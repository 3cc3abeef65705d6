"""Calibration: the machine's numbers under every model of its structure, what data can know, how accurate it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from schemas.artifacts import ARTIFACTS
from stages.declaration import Outcome, Progress, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign
    from stages.calibration_data import Gathered

LEAST_POSES = 3
LEAST_LEGS = 6  # with fewer, readings leave the platform free

DECLARATION = Stage(
    name="calibrate",
    reads=("configurations?", "survey?", "poses", "deformation", "deformation_models"),
    leaves=(
        "calibration",
        "implicit_calibration",
        "correlations",
        "accuracy",
        "implicit_accuracy",
        "model_choice",
        "observability",
        "absorption",
        "requirements",
    ),
    settings=(
        "mechanism.type",
        "mechanism.legs",
        "mechanism.tolerance",
        "mechanism.flexure",
        "mechanism.leg_tube",
        "noise.point_mm",
        "noise.actuator_mm",
        "requirement",
    ),
    summary="kinematic and stiffness models identified, with what the data can know of them",
)


def run(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Calibrate every model that the mechanism's numbers allow, and choose among them."""
    if not settings.mechanism.is_legged:
        return not_evaluated(f"mechanism {settings.mechanism.type}: no legs whose readings say where the platform is")
    if "configurations" not in tables:
        return not_evaluated("needs the actuators' readings (configurations)")
    from stages.calibration_data import gather
    from stages.calibration_run import NothingCalibrated, calibrate

    try:
        gathered = gather(tables, settings)
    except ValueError as why:
        return not_evaluated(str(why))
    if unreached := _unreached(gathered):
        return not_evaluated(unreached)
    try:
        return calibrate(gathered, settings.requirement, progress)
    except NothingCalibrated as why:
        return not_evaluated(str(why))


def _unreached(gathered: Gathered) -> str:
    """Why the nominal mechanism cannot be calibrated from these poses; empty where it can."""
    import numpy as np

    from truing.simulation.kinematics import reaches

    fitted = int(np.sum(gathered.measured.roles != "verification"))
    if fitted < LEAST_POSES:
        return f"needs at least {LEAST_POSES} poses that are not for verification, found {fitted}"
    legs = gathered.machine.legs
    if legs.count >= LEAST_LEGS and not reaches(legs, legs.rho0[None]).all():
        return "the legs of [mechanism] cannot meet the platform at their reference readings"
    return ""


def not_evaluated(why: str) -> Outcome:
    """The outcome of a campaign that does not hold what this stage needs."""
    empty = {name: ARTIFACTS[name].empty() for name in DECLARATION.leaves}
    return Outcome(empty, read="nothing", left_out="nothing", figure=f"not evaluated: {why}")
