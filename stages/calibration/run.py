"""All calibrations of a campaign one after the other, and the tables that they leave."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.calibration.accuracy import PoseErrors, nominal_errors
from truing.calibration.choice import Judged, choice, doubts
from truing.calibration.every_case import Failure, calibrations, judged, screened_poses
from truing.calibration.extended import MODEL, Extended
from truing.calibration.fits import Calibration
from truing.calibration.measured import Gathered
from truing.calibration.question import Case, cases
from truing.calibration.screening import OFF, Screened
from truing.report.numbers import count as counted
from truing.simulation.mechanisms.parameters import SHARED, Parameter
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.stages.calibration.choice import (
    accuracy_rows,
    choice_rows,
    departure_rows,
    extended_choice_rows,
    nominal_rows,
)
from truing.stages.calibration.extended import extended_correlations, extended_parameters
from truing.stages.calibration.knowledge import absorption_rows, observability_rows
from truing.stages.common.rows import Rows
from truing.stages.common.words import listed
from truing.stages.declaration import Outcome, Progress

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.sections import Requirement

# Pairs of parameters less correlated than this are not told.
LEAST_CORRELATION = 0.05
_DISAGREES = "the pose disagrees with all others: its weight in a robust fit is 0"
_ELSEWHERE = "targets of the leg put its joints elsewhere than in the other poses"
_COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
_WITHIN = 1.959964  # of a normal error's 95 %, in standard deviations


class NothingCalibrated(Exception):
    """No model's equations could be solved; says why."""


def calibrate(gathered: Gathered, asked: Requirement, extended: Extended | None, progress: Progress) -> Outcome:
    """Calibrate every model, choose among them, and say what the data can know; the extended model stands beside them.

    Raises NothingCalibrated where no model could be.
    """
    fitted = gathered.measured.roles != "verification"
    every = list(cases(gathered, structures(gathered.machine)))
    clean = screened_poses(gathered, fitted, every)
    both = calibrations(gathered, clean, every, lambda done, total, case: progress(done, total, _words(case)))
    if not both.likely:
        raise NothingCalibrated("; ".join(map(_failure, both.failed)))
    found = [judged(gathered, one, fitted) for one in (*both.likely, *both.implicit)]
    made = choice(found[: len(both.likely)])
    best = found[made.chosen]
    measured, used = gathered.measured, clean.measured
    identifier = "int64" if isinstance(measured.poses[0], int) else "string"
    choices = choice_rows(found, measured.roles, made)
    if best.errors is not None:
        structure = structures(gathered.machine)[0]
        before = nominal_errors(structure, gathered.machine, measured)
        choices.extend(nominal_rows(structure.name, before, measured.roles))
        choices.extend(departure_rows(gathered.machine, measured.rho))
    rows = {
        "calibration": parameter_rows("calibration", both.likely),
        "implicit_calibration": parameter_rows("implicit_calibration", both.implicit),
        "correlations": correlation_rows(both.likely),
        "accuracy": _accuracy("accuracy", found[: len(both.likely)], gathered),
        "implicit_accuracy": _accuracy("implicit_accuracy", found[len(both.likely) :], gathered),
        "model_choice": choices,
        "observability": observability_rows(gathered, used, best.calibration),
        "absorption": absorption_rows(gathered, used, (*both.likely, *both.implicit)),
        "requirements": _requirements(gathered, asked, best, fitted),
    }
    if extended is not None:
        _add_extended(rows, extended, asked, gathered, fitted)
    open_questions = (*_screened_words(clean), *map(_failure, both.failed), _undeformed(gathered), _open(best))
    return Outcome(
        {name: one.table(identifier) for name, one in rows.items()} | _left_out(clean, identifier),
        read=f"{counted(len(used.poses), 'pose')} to fit, {int((~fitted).sum())} held out",
        left_out="; ".join(filter(None, (gathered.left_out, *open_questions))) or "nothing",
        figure=_figure(best, len(both.likely), measured.roles),
    )


def _left_out(clean: Screened, identifier: str) -> dict[str, pa.Table]:
    """The artifact ``calibration_left_out``; empty where nothing was."""
    rows = Rows("calibration_left_out")
    for pose in clean.poses_out:
        rows.add(pose=pose, subject="platform", reason=_DISAGREES, value=None, limit=None, unit="sigma")
    for one in clean.legs_out:
        rows.add(pose=one.pose, subject=_leg_name(one.leg), reason=_ELSEWHERE, value=one.off, limit=OFF, unit="sigma")
    return {rows.artifact: rows.table(identifier)} if rows.count else {}


def _screened_words(clean: Screened) -> list[str]:
    said, legs = [], [f"{_leg_name(one.leg)} in pose {one.pose}" for one in clean.legs_out]
    if clean.poses_out:
        said.append(f"poses that disagree with all others: {', '.join(map(str, clean.poses_out))}")
    return [*said, f"legs whose targets put them elsewhere: {listed(legs)}"] if legs else said


def _leg_name(leg: int) -> str:
    return f"leg{leg + 1}"


def _failure(one: Failure) -> str:
    return f"{_words(one.case)}{f', {one.by}' if one.by else ''}: {one.why}"


def _words(case: Case) -> str:
    deformation = {"none": "rigid platform", "linear": "linear deformation", "matrix": "matrix deformation"}
    return f"{case.structure.name}, {deformation[case.deformation]}"


def _add_extended(
    rows: dict[str, Rows], extended: Extended, asked: Requirement, gathered: Gathered, fitted: NDArray
) -> None:
    """Add the extended model to the tables of the calibrations."""
    key, measured = (MODEL, extended.deformation), gathered.measured
    rows["calibration"].extend(extended_parameters(extended))
    rows["correlations"].extend(extended_correlations(extended, LEAST_CORRELATION))
    rows["accuracy"].extend(accuracy_rows("accuracy", [(key, extended.errors)], measured))
    rows["model_choice"].extend(extended_choice_rows(extended, measured.roles))
    noise = measured.platform.covariance
    rows["requirements"].extend(requirement_rows(asked, key, extended.errors, noise, ~fitted))


def _accuracy(artifact: str, judged: Sequence[Judged], gathered: Gathered) -> Rows:
    told = [(one.calibration, one.errors) for one in judged if one.errors is not None]
    return accuracy_rows(artifact, [(one.case.key, errors) for one, errors in told], gathered.measured)


def _requirements(gathered: Gathered, asked: Requirement, best: Judged, fitted: NDArray) -> Rows:
    if best.errors is None:
        return Rows("requirements")
    return requirement_rows(
        asked, best.calibration.case.key, best.errors, gathered.measured.platform.covariance, ~fitted
    )


def _open(best: Judged) -> str:
    few = "accuracy and requirements: fewer than six legs leave the platform free, readings do not say where it is"
    return few if best.errors is None else ""


def _undeformed(gathered: Gathered) -> str:
    said = "models of deformation: fewer than three platform targets away from the attachments, whose frame deforms too"
    return said if gathered.modulo_plane else ""


def _figure(best: Judged, count: int, roles: NDArray) -> str:
    said = f"{_words(best.calibration.case)} chosen of {counted(count, 'model')}"
    against = f"; {told}" if (told := doubts(best)) else ""
    if best.errors is None:
        return said + against
    held = roles == "verification"
    which = "held-out" if held.any() else "calibration"
    told = best.errors.position[held if held.any() else ~held] * 1e6
    return f"{said}: {which} position error {np.nanmean(told):.1f} um mean, {np.nanmax(told):.1f} um at most{against}"


def parameter_rows(artifact: str, calibrations: Sequence[Calibration]) -> Rows:
    """Return every identified parameter of every calibration, in the units of the tables."""
    rows = Rows(artifact)
    for calibration in calibrations:
        entries, units = calibration.parameters.entries, calibration.parameters.units
        rows.add(
            model=calibration.case.structure.name,
            deformation=calibration.case.deformation,
            leg=[_leg(entry) for entry in entries],
            parameter=[entry.name for entry in entries],
            unit=[entry.unit for entry in entries],
            nominal=calibration.nominal / units,
            identified=calibration.values / units,
            sigma=calibration.sigma / units,
            tolerance=calibration.tolerance / units,
            pull=calibration.pull,
            identifiable=calibration.identifiable,
            status=calibration.status,
        )
    return rows


def correlation_rows(calibrations: Sequence[Calibration]) -> Rows:
    """Return the correlated pairs of every calibration's parameters."""
    rows = Rows("correlations")
    for calibration in calibrations:
        entries = calibration.parameters.entries
        correlation = calibration.covariance / np.outer(calibration.sigma, calibration.sigma)
        first, second = np.nonzero(np.triu(np.abs(np.nan_to_num(correlation)) >= LEAST_CORRELATION, 1))
        rows.add(
            model=calibration.case.structure.name,
            deformation=calibration.case.deformation,
            leg=[_leg(entries[i]) for i in first],
            parameter=[entries[i].name for i in first],
            other_leg=[_leg(entries[j]) for j in second],
            other_parameter=[entries[j].name for j in second],
            correlation=np.clip(correlation[first, second], -1.0, 1.0),
        )
    return rows


def _leg(entry: Parameter) -> int | None:
    return None if entry.leg == SHARED else entry.leg + 1


def requirement_rows(
    asked: Requirement, key: tuple[str, str], errors: PoseErrors, measurement: NDArray, held_out: NDArray
) -> Rows:
    """Return a row per component that something is asked of, judged by the errors of a model (model, deformation).

    measurement (B, 6, 6): covariance of the measured poses, whose noise is not the machine's; held_out (B,): the poses
    judged by, and where there are none all of them. The error is what 95 of 100 poses stay below: 1.96 rms of measured
    minus predicted, less the measurement's share; the interval is that of the rms of so many normal errors.
    """
    rows, judged = Rows("requirements"), held_out if held_out.any() else ~held_out
    by = "" if held_out.any() else ", judged by the poses that were fitted"
    for i, name in enumerate(_COMPONENTS):
        unit = "mm" if i < 3 else "deg"
        limit = getattr(asked, f"{name}_{unit}")
        if limit is not None:
            si = 1e-3 if i < 3 else np.pi / 180
            found = _interval(errors.error[judged, i] / si, measurement[judged, i, i] / si**2)
            _add_requirement(rows, key, name, unit, limit, found, by)
    return rows


def _interval(errors: NDArray, variances: NDArray) -> tuple[float, float, float] | None:
    """Return the 95 % error with the ends of its interval; None without poses."""
    from scipy.special import chdtri

    told = np.isfinite(errors)
    count = int(told.sum())
    if not count:
        return None
    square = float(np.sum(errors[told] ** 2))
    # A measurement that is said to be noisier than what was seen of it tells less, not more.
    noise = min(float(np.mean(variances[told])), square / count)
    scales = (count, chdtri(count, 0.025), chdtri(count, 0.975))
    middle, low, high = (_WITHIN * float(np.sqrt(max(square / scale - noise, 0.0))) for scale in scales)
    return middle, low, high


def _add_requirement(
    rows: Rows,
    key: tuple[str, str],
    component: str,
    unit: str,
    limit: float,
    found: tuple[float, float, float] | None,
    by: str,
) -> None:
    error, lower, upper = found or (None, None, None)
    verdict = "not evaluated" if upper is None or lower is None else _verdict(lower, upper, limit)
    rows.add(
        model=key[0],
        deformation=key[1],
        component=component,
        requirement=limit,
        error=error,
        lower=lower,
        upper=upper,
        unit=unit,
        verdict=verdict,
        message=_requirement_message(component, verdict, limit, unit, found) + by,
    )


def _verdict(lower: float, upper: float, limit: float) -> str:
    if upper <= limit:
        return "meets"
    return "fails" if lower > limit else "undecided"


def _requirement_message(
    component: str, verdict: str, limit: float, unit: str, found: tuple[float, float, float] | None
) -> str:
    if found is None:
        return f"{component}: no pose to judge by"
    error, lower, upper = found
    told = f"95 of 100 poses stay below {error:.2g} {unit} (between {lower:.2g} and {upper:.2g})"
    if error == 0:
        told = f"no error beyond the measurement's own noise (at most {upper:.2g} {unit})"
    return f"{component}: {told}, asked for {limit:g} {unit}: {verdict}"
