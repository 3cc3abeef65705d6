"""Errors of predicted poses, of calibrated machines and of the extended model, and the choice between calibrations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.calibration.calibration_input import MeasuredPlatform, under_load
from truing.calibration.estimation_problem import common_effects, independent_covariance, is_deformation, with_common
from truing.calibration.fits import MAXIMUM_LIKELIHOOD, MachineCalibration
from truing.estimation.held_out import Contender, ContenderChoice, choose_model, held_out_misfit
from truing.estimation.interval import Interval
from truing.estimation.rotation import log_so3
from truing.inference.pulls import IDENTIFIABLE
from truing.schemas.verdict import BY_A_FACTOR, does_not_fit
from truing.simulation.cause import Effect
from truing.simulation.change import Change
from truing.simulation.mechanisms.extended_model import (
    ExtendedModel,
    IdentifiedGeometry,
    acts_on_poses,
    identified_geometry,
    predict_poses,
    some_of,
)
from truing.simulation.mechanisms.parameters import ParameterSet
from truing.simulation.mechanisms.structures.structure import Machine, Structure, reached_poses

if TYPE_CHECKING:
    from truing.simulation.mechanisms.recording import Conditions

ARCSEC = np.pi / 180 / 3600
MODEL, ESTIMATOR = "extended", "points"
UNCORRECTED = "uncorrected"  # no model: the machine as it is
# Deformation of the platform in the model, by the cause that was found; the first one counts.
_DEFORMATIONS = {
    "platform-deformation-matrix": "matrix",
    "platform-deformation-nonlinear": "nonlinear",
    "platform-deformation-linear": "linear",
}
Figure = tuple[str, float, str]
WITHIN = 1.959964  # half width of the 95 % interval of a normal error, in standard deviations
MOST_DECIDING = 1000  # most additional poses that anybody would measure
_UNLIKELY = 1e-3  # p-value of a misfit, or of pulls, below which the model is doubted


@dataclass(frozen=True)
class PoseErrors:
    """Measured minus predicted poses, error (B, 6): m and rad, base frame; noise (B, 6, 6): its expected covariance."""

    error: NDArray
    noise: NDArray

    @property
    def position(self) -> NDArray:
        """Position errors (B,), m."""
        return np.sqrt(np.sum(self.error[:, :3] ** 2, -1))

    @property
    def orientation(self) -> NDArray:
        """Orientation errors (B,), rad."""
        return np.sqrt(np.sum(self.error[:, 3:] ** 2, -1))

    def expected(self, first: int) -> NDArray:
        """Return the rms (B,) that noise alone causes in the three components from ``first`` on."""
        variances = np.diagonal(self.noise, axis1=1, axis2=2)[:, first : first + 3]
        return np.sqrt(np.maximum(variances.sum(-1), 0.0))


def pose_errors(
    calibration: MachineCalibration, measured: MeasuredPlatform, reading_sigma: float, fitted: NDArray
) -> PoseErrors:
    """Return the errors at all measured poses.

    ``fitted`` (B,) marks poses that took part in the calibration; their errors are correlated with the parameters.
    """
    change, count = calibration.parameters.change(calibration.machine), len(calibration.values)
    return _errors(
        calibration.case.structure,
        calibration.machine,
        change,
        measured,
        _ErrorSources(
            reading_sigma,
            np.where(fitted[:, None, None], -calibration.declared, calibration.covariance),
            np.where(fitted[:, None, None], 0.0, calibration.joint[:count, count:]),
        ),
    )


def nominal_errors(structure: Structure, machine: Machine, measured: MeasuredPlatform) -> PoseErrors:
    """Return the errors of an uncalibrated machine."""
    return machine_errors(structure, machine, measured, 0.0)


def machine_errors(
    structure: Structure, machine: Machine, measured: MeasuredPlatform, reading_sigma: float
) -> PoseErrors:
    """Return the errors of a machine with exact parameters; reading_sigma, m."""
    none = ParameterSet(()).change(machine)
    poses, common = len(measured.rho), common_effects(measured).shape[-1]
    exact = _ErrorSources(reading_sigma, np.zeros((poses, 0, 0)), np.zeros((poses, 0, common)))
    return _errors(structure, machine, none, measured, exact)


@dataclass(frozen=True)
class _ErrorSources:
    """Sigma of a reading in m, covariance (B, P, P) of the parameters, and theirs (B, P, K) with errors common to all
    poses."""

    reading_sigma: float
    parameters: NDArray
    with_common: NDArray


def _errors(
    structure: Structure, machine: Machine, change: Change, measured: MeasuredPlatform, sources: _ErrorSources
) -> PoseErrors:
    poses = reached_poses(structure, under_load(machine, measured), measured.rho, change)
    turned = log_so3(measured.platform.R @ np.swapaxes(poses.R, -1, -2))
    error = np.concatenate([measured.platform.p - poses.p, turned], -1)
    shared = poses.by_parameter @ sources.with_common @ np.swapaxes(common_effects(measured), -1, -2)
    noise = measured.platform.covariance + poses.covariance(sources.reading_sigma, sources.parameters)
    noise = noise + shared + np.swapaxes(shared, -1, -2)
    return PoseErrors(np.where(poses.converged[:, None], error, np.nan), noise)


def misfit(calibration: MachineCalibration, measured: MeasuredPlatform, reading_sigma: float) -> NDArray:
    """Return the chi-square of the closures per pose (B,), at poses that took no part in the calibration."""
    problem = with_common(calibration.problem_at(measured), measured)
    values = np.concatenate([calibration.values, calibration.common]) if problem.common else calibration.values
    at = problem.constrain(values, np.zeros((len(measured.rho), problem.deviations)))
    noise, known = independent_covariance(measured, reading_sigma), calibration.joint[: len(values), : len(values)]
    return held_out_misfit(at.value, at.by_deviation, at.by_values, noise, known)


@dataclass(frozen=True)
class Extended:
    """The extended model of a campaign, its errors at the measured poses, and whether it is the main calibration."""

    found: ExtendedModel
    errors: PoseErrors
    is_main: bool = False

    @property
    def deformation(self) -> str:
        """Name of the platform's deformation in the model."""
        ids = {cause.id for cause in self.found.model.causes}
        return next((name for cause, name in _DEFORMATIONS.items() if cause in ids), "none")

    @cached_property
    def geometry(self) -> IdentifiedGeometry:
        """Identified geometry."""
        return identified_geometry(self.found.model, self.found.shared, self.found.covariance)

    @property
    def effects(self) -> tuple[tuple[Effect, NDArray], ...]:
        """Effects of the model, with the covariance (P, P) of their parameters, SI."""
        model = self.found.model
        parts = [(effect, model.layout[effect.cause.key]) for effect in model.effects(self.found.shared)]
        scales = [model.effect_sigma(effect.cause) for effect, _ in parts]
        return tuple(
            (effect, self.found.covariance[part, part] * np.outer(scale, scale))
            for (effect, part), scale in zip(parts, scales, strict=True)
        )


def errors_at(
    extended: ExtendedModel, conditions: Conditions, measured: MeasuredPlatform, fitted: NDArray
) -> PoseErrors:
    """Return measured minus predicted poses, with the instrument's effects in the prediction; NaN where an input is
    unknown."""
    error, noise = np.full((len(fitted), 6), np.nan), np.zeros((len(fitted), 6, 6))
    rows = np.flatnonzero(_has_all_inputs(extended, conditions))
    if len(rows):
        poses = predict_poses(extended, some_of(conditions, rows), recorded=True)
        platform = measured.platform.subset(rows)
        turned = log_so3(platform.R @ np.swapaxes(poses.R, -1, -2))
        away = np.concatenate([platform.p - poses.p, turned], -1)
        error[rows] = np.where(poses.converged[:, None], away, np.nan)
        # The model was fitted to these poses, so their errors are correlated with its own.
        shared = np.where(fitted[rows, None, None], 2.0, 0.0) * poses.of_model
        noise[rows] = platform.covariance + poses.covariance - shared
    return PoseErrors(error, noise)


def _has_all_inputs(extended: ExtendedModel, conditions: Conditions) -> NDArray:
    """Return True for poses (B,) at which every input of the model's effects has a number."""
    legs = extended.model.nominal.count
    needed = {name for cause in extended.model.causes if acts_on_poses(cause) for name in cause.needs(legs)}
    columns = [conditions.covariates[name] for name in needed & conditions.covariates.keys()]
    known = [np.isfinite(column.reshape(len(column), -1)).all(1) for column in columns]
    return np.logical_and.reduce([np.ones(len(conditions.readings), bool), *known])


def identifiable(geometry: IdentifiedGeometry) -> NDArray:
    """Mask (P,) of parameters of whose prior variance the data remove at least the share IDENTIFIABLE."""
    return np.asarray(1.0 - geometry.sigma**2 / np.diag(geometry.prior) >= IDENTIFIABLE)


@dataclass(frozen=True)
class AssessedCalibration:
    """A calibration with its errors at all poses and the chi-square (B,) of held-out poses, each with expectation
    ``equations``."""

    calibration: MachineCalibration
    errors: PoseErrors | None
    squares: NDArray
    equations: int


def choice(assessed: Sequence[AssessedCalibration]) -> ContenderChoice:
    """Return the choice among maximum-likelihood calibrations."""
    return choose_model(
        [
            Contender(
                row.squares,
                row.equations,
                row.calibration.log_evidence,
                len(row.calibration.values),
                row.calibration.status == "ok",
            )
            for row in assessed
        ]
    )


def _pull_p_value(calibration: MachineCalibration, pulls: NDArray) -> float:
    """Return the p-value of the shifts of selected parameters (P,), if the tolerances are right. The shift from nominal
    has the covariance of the tolerances minus that of the parameters, so shifts are correlated."""
    from scipy.special import chdtrc

    spread = np.diag(calibration.tolerance[pulls] ** 2) - calibration.declared[np.ix_(pulls, pulls)]
    shift = (calibration.values - calibration.nominal)[pulls]
    return float(chdtrc(len(shift), max(float(shift @ np.linalg.solve(spread, shift)), 0.0)))


def shortcoming(assessed: AssessedCalibration) -> str:
    """Return in words the shortcoming of a calibration and its remedy; empty where it fits and predicts
    held-out poses."""
    figures = {name: value for name, value, _ in fit_figures(assessed)}
    missed = ""
    if "misfit_p_value" in figures:
        ratio = float(np.sqrt(figures["chi_square"] / figures["freedom"]))
        if does_not_fit(figures["misfit_p_value"], ratio):
            missed = f"what it was fitted to by {ratio:.3g} times the declared noise"
    if not missed and figures.get("p_value", 1.0) < _UNLIKELY and figures["heldout_ratio"] > BY_A_FACTOR:
        missed = f"what was held out by {figures['heldout_ratio']:.3g} times what noise leaves"
    return missed and f"the model misses {missed}; correct [noise], or find the cause that is missing"


def doubts(assessed: AssessedCalibration) -> str:
    """Return in words an unlikely misfit or unlikely pulls of a calibration; empty where there are none."""
    figures = {name: value for name, value, _ in fit_figures(assessed)}
    texts = []
    if figures.get("misfit_p_value", 1.0) < _UNLIKELY:
        texts.append(f"misfit {np.sqrt(figures['chi_square'] / figures['freedom']):.1f} times the declared noise")
    if figures.get("pull_p_value", 1.0) < _UNLIKELY:
        texts.append(f"parts {figures['rms_pull']:.1f} times further from nominal than their tolerances let expect")
    return "; ".join(texts)


def _interval_of_mean(mean: float, noise: float, count: int) -> Interval:
    """Return the 95 % bound of an error with its interval, from the mean square of normal errors minus
    that of noise."""
    from scipy.special import chdtri

    scales = (1.0, chdtri(count, 0.025) / count, chdtri(count, 0.975) / count)
    return Interval(*(WITHIN * float(np.sqrt(max(mean / scale - noise, 0.0))) for scale in scales))


@dataclass(frozen=True)
class Decision:
    """Number of poses of an undecided requirement, number of additional poses that would decide it, and the result
    then.

    ``more_poses`` and ``then`` are None where `MOST_DECIDING` are not enough.
    """

    poses: int
    more_poses: int | None = None
    then: Interval | None = None


def error_of_95_percent(errors: NDArray, variances: NDArray) -> Interval | None:
    """Return the bound that 95 % of poses meet in one component: 1.96 times the rms, without measurement noise.

    errors (N,), NaN where there is none, and variances (N,) of the measurement, in one unit; None without any error.
    The interval is that of the rms of N normal errors.
    """
    reported = np.isfinite(errors)
    count = int(reported.sum())
    if not count:
        return None
    mean = float(np.mean(errors[reported] ** 2))
    # If the declared noise is larger than the observed scatter, only that scatter is subtracted.
    return _interval_of_mean(mean, min(float(np.mean(variances[reported])), mean), count)


def chance_at_limit(errors: NDArray, variances: NDArray, limit: float) -> float:
    """Return the two-sided p-value of errors this far from a limit, if the true bound of 95 % of poses is the limit.

    The interval of `error_of_95_percent` at confidence 1 - p ends at the limit. errors, variances, limit: as there; NaN
    without any error.
    """
    from scipy.special import chdtr, chdtrc

    reported = np.isfinite(errors)
    count = int(reported.sum())
    if not count:
        return float("nan")
    mean = float(np.mean(errors[reported] ** 2))
    expected = (limit / WITHIN) ** 2 + min(float(np.mean(variances[reported])), mean)
    if expected <= 0.0:  # no error above the noise, and none allowed
        return 1.0
    squares = count * mean / expected
    return float(min(1.0, 2.0 * min(chdtr(count, squares), chdtrc(count, squares))))


def deciding_pose_count(errors: NDArray, variances: NDArray, limit: float, spare: int = 0) -> Decision | None:
    """Return the number of poses that decide whether 95 % of errors are below a limit, if further errors are as large.

    errors, variances: as in `error_of_95_percent`; limit in their unit; spare: measured poses that no longer count once
    there are more. None where the question is decided, and where no pose was measured.
    """
    interval = error_of_95_percent(errors, variances)
    if interval is None or not interval.lower <= limit < interval.upper:
        return None
    reported = np.isfinite(errors)
    mean = float(np.mean(errors[reported] ** 2))
    noise, there = min(float(np.mean(variances[reported])), mean), int(reported.sum()) - spare
    totals = (count for count in range(there + 1, there + MOST_DECIDING + 1))
    each = ((count, _interval_of_mean(mean, noise, count)) for count in totals)
    fits = next(((count, then) for count, then in each if not then.lower <= limit < then.upper), None)
    return Decision(int(reported.sum())) if fits is None else Decision(int(reported.sum()), fits[0] - there, fits[1])


def deciding_count(mean: float, noise: float, limit: float) -> int | None:
    """Return the least number of poses that decide whether 95 % of errors are below a limit.

    mean: mean square of the measured errors, of which ``noise`` is the variance of the measurement; both in the square
    of the limit's unit. None where `MOST_DECIDING` poses are not enough.
    """
    low, high = 0, 1
    while high <= MOST_DECIDING and not _is_decided(mean, noise, limit, high):
        low, high = high, 2 * high
    if high > MOST_DECIDING:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if _is_decided(mean, noise, limit, middle) else (middle, high)
    return high


def _is_decided(mean: float, noise: float, limit: float, count: int) -> bool:
    interval = _interval_of_mean(mean, noise, count)
    return not interval.lower <= limit < interval.upper


def error_figures(errors: PoseErrors | None, roles: NDArray) -> list[Figure]:
    """Mean and largest errors of position, um, and orientation, arcsec, with the noise floor, by role of the pose."""
    if errors is None:
        return []
    figures: list[Figure] = []
    for part, values, unit, si in (
        ("position", errors.position, "um", 1e-6),
        ("orientation", errors.orientation, "arcsec", ARCSEC),
    ):
        for name, rows in (("calibration", roles != "verification"), ("verification", roles == "verification")):
            reported = values[rows][np.isfinite(values[rows])] / si
            if len(reported):
                figures.append((f"{part}_mean_{name}", float(reported.mean()), unit))
                figures.append((f"{part}_max_{name}", float(reported.max()), unit))
                floor = errors.expected(0 if part == "position" else 3)[rows] / si
                figures.append((f"{part}_noise_{name}", float(np.sqrt(np.mean(floor**2))), unit))
    return figures


def fit_figures(assessed: AssessedCalibration) -> list[Figure]:
    """Figures of the fit: misfit, pulls and their p-values."""
    from scipy.special import chdtrc

    calibration = assessed.calibration
    geometry = [not is_deformation(entry) for entry in calibration.parameters.entries]
    reported = calibration.pull[np.isfinite(calibration.pull) & geometry]
    figures: list[Figure] = [
        ("parameters", float(len(calibration.values)), "1"),
        ("poses", float(calibration.kept.sum()), "1"),
        ("poses_downweighted", float((~calibration.kept).sum()), "1"),
        ("chi_square", calibration.chi_square, "1"),
        ("freedom", calibration.freedom, "1"),
        ("pull_freedom", float(len(reported)), "1"),
    ]
    if np.isfinite(calibration.chi_square) and calibration.freedom > 0:
        figures.append(("misfit_p_value", float(chdtrc(calibration.freedom, calibration.chi_square)), "1"))
    if len(reported):
        figures.append(("rms_pull", float(np.sqrt(np.mean(reported**2))), "1"))
    if len(reported) and calibration.estimator == MAXIMUM_LIKELIHOOD:
        figures.append(("pull_p_value", _pull_p_value(calibration, np.isfinite(calibration.pull) & geometry), "1"))
    if np.isfinite(calibration.log_evidence):
        figures.append(("log_evidence", calibration.log_evidence, "1"))
    if len(assessed.squares):
        expected = assessed.equations * len(assessed.squares)
        figures.append(("heldout_ratio", float(np.sqrt(assessed.squares.sum() / expected)), "1"))
        figures.append(("p_value", float(chdtrc(expected, assessed.squares.sum())), "1"))
    return figures
