"""All calibrations of a mechanism, and their tables."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.belonging.relation import RelationState
from truing.calibration.accuracy import AssessedCalibration, Extended, choice, doubts, shortcoming
from truing.calibration.calibration_input import CalibrationData
from truing.calibration.estimation_problem import Case, cases
from truing.calibration.fits import MachineCalibration
from truing.calibration.flexure_observability import flexure_design_parameters
from truing.calibration.model_cases import (
    LEAST_LEGS,
    OFF,
    CalibrationsByEstimator,
    ScreenedPoses,
    assessed_calibration,
    calibrations,
    screened_poses,
)
from truing.estimation.rotation import log_so3
from truing.report.numbers import count_text, listed
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.cause import Step
from truing.simulation.mechanisms.legs.kinematics import inverse, reaches
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.stages.calibration.component_requirements import with_component_requirements
from truing.stages.calibration.extended import add_extended, compared_rows, extended_of
from truing.stages.calibration.model_rows import (
    absorption_rows,
    accuracy_rows,
    add_uncalibrated,
    choice_rows,
    correlation_rows,
    flexure_rows,
    observability_rows,
    parameter_rows,
    requirement_rows,
)
from truing.stages.common.applied_findings import applied_findings
from truing.stages.common.calibration_data import assemble
from truing.stages.common.missing_data import HELD_OUT, why_no_calibration, why_too_few_poses
from truing.stages.common.rows import Rows
from truing.stages.declaration import Outcome, Progress

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.sections import Requirement

LEAVES = (
    *("calibration", "implicit_calibration", "correlations", "accuracy", "implicit_accuracy"),
    *("model_choice", "observability", "absorption", "requirements"),
)
LEAST_MOVEMENT = 10.0  # of the platform, in sigmas of its position, below which the machine did not move
_DISAGREES = "the pose disagrees with all others: its weight in a robust fit is 0"
_ELSEWHERE = "targets of the leg give other joint positions than in the other poses"
_NO_FRAME = (
    "models of deformation: fewer than three platform targets away from the attachments, whose frame deforms too"
)
_FREE = "accuracy and requirements: fewer than six legs do not constrain the platform, so readings give no pose"
_DEFORMATION = {"none": "rigid platform", "linear": "linear deformation", "matrix": "matrix deformation"}
_DEFORMATION["in-plane"] = "matrix deformation along z, x and y"


def calibrate_mechanism(tables: Mapping[str, pa.Table], settings: Campaign, progress: Progress) -> Outcome:
    """Fit every model that the mechanism allows, choose one, and determine the observability."""
    bodies = tables["observations"]["body"].unique().to_pylist() if "observations" in tables else []
    if why := why_no_calibration(settings.mechanism, tables, bodies):
        return with_component_requirements(nothing_calibrated(why), tables, settings, incomplete_picture(tables))
    try:
        data = assemble(tables, settings)
    except ValueError as error:
        return nothing_calibrated(str(error))
    fitted = data.measured.roles != HELD_OUT
    if why := why_too_few_poses(int(fitted.sum())) or _too_little(data) or _reason_unreachable(data):
        return nothing_calibrated(why)
    findings = applied_findings(tables)
    extended = None
    if findings.text is not None:
        extended = extended_of(findings.text, tables, data.measured, fitted, is_main=findings.is_main)
    wrong = "" if findings.is_main else wrong_poses(tables)
    return _calibrated(data, fitted, settings.requirement, extended, (incomplete_picture(tables), wrong), progress)


def wrong_poses(tables: Mapping[str, pa.Table]) -> str:
    """Reason why the recorded poses judge no calibration by them: a found cause makes all of them wrong; else empty."""
    rows = tables["diagnosis"].to_pylist() if "diagnosis" in tables else []
    found_rows = [row for row in rows if row["verdict"] == "found" and row.get("in_model", True) and not row["subject"]]
    names = [row["cause"] for row in found_rows if json.loads(row["settings"] or "{}").get("step") == Step.INSTRUMENT]
    if not names:
        return ""
    return (
        f"the diagnosis found that all measured poses are wrong ({', '.join(names)}), the verification poses too; "
        "correct the data, or apply the finding ([diagnosis] apply)"
    )


def incomplete_picture(tables: Mapping[str, pa.Table]) -> str:
    """Misfit of the last model of the diagnosis if its adequacy fails; else empty."""
    from truing.report.diagnosis.adequacy import adequacy_verdict

    known = {name: tables[name].to_pandas() for name in ("diagnosis", "adequacy", "prediction") if name in tables}
    verdict = adequacy_verdict(known, {})
    return verdict.explanation if verdict is not None and verdict.state == RelationState.FAILS else ""


def nothing_calibrated(why: str) -> Outcome:
    """Outcome of a campaign without a calibration."""
    return Outcome.not_evaluated({name: ARTIFACTS[name].empty() for name in LEAVES}, why)


def _too_little(data: CalibrationData) -> str:
    """Reason why these poses determine no machine; else empty."""
    platform = data.measured.platform
    away = np.concatenate([platform.p - platform.p[0], log_so3(platform.R @ platform.R[0].T)], -1)
    noise = np.sqrt(np.diagonal(platform.covariance, axis1=1, axis2=2).mean(0))
    if np.all(np.ptp(away, axis=0) <= LEAST_MOVEMENT * noise):
        return "the platform hardly moved: its poses differ only by their noise"
    return ""


def _reason_unreachable(data: CalibrationData) -> str:
    """Reason why the nominal mechanism cannot be calibrated at these readings; else empty."""
    legs, rho, platform = data.machine.legs, data.measured.rho, data.measured.platform
    if 2 * np.isfinite(inverse(legs, platform.p, platform.R)).all(1).sum() < len(rho):
        return "the legs of [mechanism] do not reach these poses at any reading"
    if legs.count < LEAST_LEGS:
        return ""
    if not reaches(legs, legs.rho0[None]).all():
        return "the legs of [mechanism] cannot meet the platform at their reference readings"
    count, poses_text = int((~reaches(legs, rho)).sum()), count_text(len(rho), "pose")
    text = f"the legs of [mechanism] cannot meet the platform at the readings of {count} of {poses_text}"
    return text if 2 * count > len(rho) else ""


def _calibrated(
    data: CalibrationData,
    fitted: NDArray,
    requirement: Requirement,
    extended: Extended | None,
    doubts: tuple[str, str],
    progress: Progress,
) -> Outcome:
    """Tables of all calibrations of the poses fitted (B,), and of the extended model.

    ``doubts``: misfit of the last model of the diagnosis, and why recorded poses judge none; else empty.
    """
    incomplete, wrong = doubts
    every = list(cases(data, structures(data.machine)))
    clean = screened_poses(data, fitted, every)
    both = calibrations(data, clean, every, lambda done, total, case: progress(done, total, _words(case)))
    failures = [
        f"{_words(failure.case)}{f', {failure.by}' if failure.by else ''}: {failure.why}" for failure in both.failed
    ]
    if not both.likely:
        return nothing_calibrated("; ".join(failures))
    likely = [assessed_calibration(data, candidate, fitted) for candidate in both.likely]
    closed = [assessed_calibration(data, closed_fit, fitted) for closed_fit in both.implicit]
    made = choice(likely)
    best, measured = likely[made.chosen], data.measured
    rows = _rows_of_calibrations(data, clean, both, best.calibration) | {
        "accuracy": _accuracy("accuracy", likely, data),
        "implicit_accuracy": _accuracy("implicit_accuracy", closed, data),
        "model_choice": choice_rows([*likely, *closed], measured.roles, made),
        "requirements": Rows("requirements"),
    }
    if best.errors is not None:
        add_uncalibrated(rows["model_choice"], data.machine, measured)
        noise = np.diagonal(measured.platform.covariance, axis1=1, axis2=2)
        key, why_not = best.calibration.case.key, shortcoming(best) or incomplete or wrong
        rows["requirements"] = requirement_rows(requirement, key, best.errors.error, noise, ~fitted, why_not)
    if extended is not None:
        add_extended(rows, extended, requirement, data, fitted, incomplete)
        if extended.effects and best.errors is not None:
            rows["calibrations_compared"] = compared_rows(best, extended, fitted)
    for name in ("calibration_left_out", "flexure_parameters"):
        if not rows[name].count:
            del rows[name]
    identifier = "int64" if isinstance(measured.poses[0], int) else "string"
    no_frame, free = _NO_FRAME if data.modulo_plane else "", "" if best.errors else _FREE
    open_questions = (data.left_out, *_screened_words(clean), *failures, no_frame, free)
    return Outcome(
        {name: rows_of_artifact.table(identifier) for name, rows_of_artifact in rows.items()},
        read=f"{count_text(len(clean.measured.poses), 'fitted pose')}, {int((~fitted).sum())} held out",
        left_out="; ".join(filter(None, open_questions)) or "nothing",
        figure=_figure(best, len(both.likely), ~fitted) + _applied(extended),
    )


def _rows_of_calibrations(
    data: CalibrationData, clean: ScreenedPoses, both: CalibrationsByEstimator, best: MachineCalibration
) -> dict[str, Rows]:
    """Rows of all calibrations: parameters, correlations, observability, absorption; and of poses left
    out."""
    used = clean.measured
    return {
        "calibration": parameter_rows("calibration", both.likely),
        "implicit_calibration": parameter_rows("implicit_calibration", both.implicit),
        "correlations": correlation_rows(both.likely),
        "observability": observability_rows(data, used, best),
        "flexure_parameters": flexure_rows(flexure_design_parameters(data, used.subset(clean.kept))),
        "absorption": absorption_rows(data, used, (*both.likely, *both.implicit)),
        "calibration_left_out": _left_out_rows(clean),
    }


def _applied(extended: Extended | None) -> str:
    """Findings in the main calibration, in words; empty for the data as recorded."""
    if extended is None or not extended.is_main:
        return ""
    names = dict.fromkeys(effect.cause.id for effect, _ in extended.effects)
    return f"; main results with {listed(list(names))} applied"


def _left_out_rows(clean: ScreenedPoses) -> Rows:
    rows = Rows("calibration_left_out")
    for pose in clean.rejected_poses:
        rows.add(pose=pose, subject="platform", reason=_DISAGREES, unit="sigma")
    for leg_in_pose in clean.legs_out:
        leg = f"leg{leg_in_pose.leg + 1}"
        rows.add(pose=leg_in_pose.pose, subject=leg, reason=_ELSEWHERE, value=leg_in_pose.off, limit=OFF, unit="sigma")
    return rows


def _screened_words(clean: ScreenedPoses) -> list[str]:
    texts, legs = [], [f"leg{leg_in_pose.leg + 1} in pose {leg_in_pose.pose}" for leg_in_pose in clean.legs_out]
    if clean.rejected_poses:
        texts.append(f"poses that disagree with all others: {', '.join(map(str, clean.rejected_poses))}")
    return [*texts, f"legs with inconsistent targets: {listed(legs)}"] if legs else texts


def _words(case: Case) -> str:
    return f"{case.structure.name}, {_DEFORMATION[case.deformation]}"


def _accuracy(artifact: str, assessed: list[AssessedCalibration], data: CalibrationData) -> Rows:
    reported = [(row.calibration.case.key, row.errors) for row in assessed if row.errors is not None]
    return accuracy_rows(artifact, reported, data.measured)


def _figure(best: AssessedCalibration, count: int, held_out: NDArray) -> str:
    text = f"chosen of {count_text(count, 'model')}: {_words(best.calibration.case)}"
    against = f"; {reported}" if (reported := doubts(best)) else ""
    if best.errors is None:
        return text + against
    which = "held-out" if held_out.any() else "fitted"
    errors_um = best.errors.position[held_out if held_out.any() else ~held_out] * 1e6
    size = f"mean {np.nanmean(errors_um):.1f} µm, largest {np.nanmax(errors_um):.1f} µm"
    return f"{text}; position error of {which} poses: {size}{against}"
