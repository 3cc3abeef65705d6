"""Calibration problems: parameters of a model, measurements with their noise, targets, and priors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.calibration.calibration_input import (
    CalibrationData,
    Deformation,
    MeasuredPlatform,
    PosesWithCovariance,
    SurveyedAttachments,
    under_load,
)
from truing.estimation.covariance import shared_parent_covariance
from truing.estimation.errors_in_variables.fit import Prior
from truing.estimation.measured_numbers import pose_numbers, shift_number
from truing.simulation.mechanisms.calibration_problem import AttachmentShifts, CalibrationProblem, CommonErrors
from truing.simulation.mechanisms.legs.leg_bodies import LegBodies, LegPoses, seated
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet, column_of, full_set, is_in_plane
from truing.simulation.mechanisms.structures.structure import Machine, Structure
from truing.simulation.targets import FREE_ANGLE_RAD, FREE_DIRECTION, FREE_LENGTH_M

DEFORMATIONS = ("none", "linear", "matrix")
OF_FLEXURES = ("beam", "stiffness", "stiffness-along")  # models of bending flexures; beta belongs to the first
IN_PLANE = "in-plane"  # matrix, with the attachments' shifts along x and y
# Prior sigma of a deformation coefficient without any knowledge.
_FREE_DEFORMATION = 0.1


def with_bodies(problem: CalibrationProblem, measured: MeasuredPlatform) -> CalibrationProblem:
    """Return the problem with the legs whose own targets determine their poses, if there are any and the structure
    allows."""
    carrying = [leg for leg, leg_poses in measured.legs.items() if leg_poses.found.any()]
    if not carrying:
        return problem
    legs = [measured.legs[leg] for leg in carrying]
    R, t, is_observed = (
        np.stack(parts, 1)
        for parts in zip(*((leg_poses.R, leg_poses.p, leg_poses.found) for leg_poses in legs), strict=True)
    )
    poses = LegPoses(np.array(carrying), R, t, is_observed)
    bodies = seated(problem.nominal.legs, problem.p, problem.R, problem.rho, poses)
    return replace(problem, leg_bodies=bodies) if bodies.fits(problem.structure, problem.nominal) else problem


def with_shifts(problem: CalibrationProblem, data: CalibrationData, measured: MeasuredPlatform) -> CalibrationProblem:
    """Return the problem with the measured shifts of attachments that carry targets, if there are any."""
    if measured.shifts is None or data.surveyed is None:
        return problem
    seen = np.flatnonzero(np.isfinite(measured.shifts.shift).any(0))
    heights = np.array([data.surveyed.b[data.surveyed.legs == leg, 2].mean() for leg in seen])
    shifts = AttachmentShifts(seen, np.nan_to_num(measured.shifts.shift[:, seen]), heights)
    return replace(problem, shifts=shifts) if len(seen) else problem


def with_common(problem: CalibrationProblem, measured: MeasuredPlatform) -> CalibrationProblem:
    """Return the problem with errors common to all poses among its unknowns, if there are any."""
    common_derivative = None if measured.network is None else _common_effects(problem, measured)[1]
    return (
        problem
        if common_derivative is None or not common_derivative.any()
        else replace(problem, common=CommonErrors(common_derivative))
    )


def _common_effects(problem: CalibrationProblem, measured: MeasuredPlatform) -> tuple[NDArray, NDArray]:
    """Return the covariance (B, N, N) of the deviations by a network of rays, and effects (B, N, K) of common errors.
    The covariance is NaN where the network does not determine it."""
    legs, poses = measured.rho.shape[1], len(measured.rho)
    names, is_measured = [*pose_numbers("platform"), *[""] * legs], [np.ones((poses, 6 + legs), bool)]
    if problem.leg_bodies is not None:
        for leg in problem.leg_bodies.leg:
            names += [*pose_numbers(f"leg{leg + 1}")]
            is_measured.append(np.repeat(measured.legs[int(leg)].found[:, None], 6, 1))
    if problem.shifts is not None and measured.shifts is not None:
        names += [shift_number(int(leg) + 1) for leg in problem.shifts.leg]
        is_measured.append(np.isfinite(measured.shifts.sigma[:, problem.shifts.leg]))
    assert measured.network is not None
    return measured.network.of(names, np.concatenate(is_measured, 1))


def noise_of_all(problem: CalibrationProblem, measured: MeasuredPlatform, noise: NDArray) -> NDArray:
    """Return the covariance (B, N, N) of all deviations; ``noise`` (B, n, n) is that of platform and readings.

    Errors common to all poses are not included: they are unknowns of the problem.
    """
    covariance = np.zeros((len(noise), problem.deviations, problem.deviations))
    covariance[:, : noise.shape[-1], : noise.shape[-1]] = noise
    if problem.leg_bodies is not None:
        _fill_legs(covariance, problem.leg_bodies, measured, noise.shape[-1])
    if problem.shifts is not None:
        _fill_shifts(covariance, problem, problem.shifts, measured)
    if measured.network is None:
        return covariance
    together, effects = _common_effects(problem, measured)
    unshared = together - effects @ np.swapaxes(effects, -1, -2)
    return np.where(np.isfinite(unshared), unshared, covariance)


def _fill_legs(covariance: NDArray, bodies: LegBodies, measured: MeasuredPlatform, first: int) -> None:
    """Add the legs to a covariance: platform and legs are relative to the base, whose error moves all of
    them together."""
    index = np.concatenate([np.arange(6), first + np.arange(bodies.deviations)])
    common = _base_effects(measured, np.concatenate([measured.platform.p[:, None], bodies.t], 1))
    platform = covariance[:, :6, :6].copy()
    covariance[:, index[:, None], index] = common
    covariance[:, :6, :6] = platform
    for k, leg in enumerate(bodies.leg):
        rows_of_leg = slice(first + 6 * k, first + 6 * k + 6)
        covariance[:, rows_of_leg, rows_of_leg] = _leg_noise(measured.legs[int(leg)])


def _fill_shifts(
    covariance: NDArray, problem: CalibrationProblem, shifts: AttachmentShifts, measured: MeasuredPlatform
) -> None:
    """Add the shifts to a covariance: they are relative to the measured platform, so its error enters with opposite
    sign."""
    found = measured.shifts.sigma[:, shifts.leg] if measured.shifts is not None else np.zeros((0, 0))
    is_observed = np.isfinite(found)
    rows = _heights_per_twist(problem, shifts) * is_observed[..., None]
    platform = measured.platform.covariance - _base_effects(measured, measured.platform.p[:, None])
    last = slice(covariance.shape[-1] - shifts.deviations, covariance.shape[-1])
    covariance[:, last, :6] = -rows @ platform
    covariance[:, :6, last] = np.swapaxes(covariance[:, last, :6], -1, -2)
    sigma = np.where(is_observed, found, FREE_LENGTH_M)
    covariance[:, last, last] = (
        rows @ platform @ np.swapaxes(rows, -1, -2) + np.eye(shifts.deviations) * sigma[:, None] ** 2
    )


def _heights_per_twist(problem: CalibrationProblem, shifts: AttachmentShifts) -> NDArray:
    """Return the motion (B, A, 6) of each attachment along the platform's z per twist (v; omega) of the platform."""
    z = np.broadcast_to(problem.R[:, None, :, 2], (len(problem.R), len(shifts.leg), 3))
    arms = problem.nominal.legs.b[shifts.leg] @ np.swapaxes(problem.R, -1, -2)
    return np.concatenate([z, np.cross(arms, z)], -1)


def _base_effects(measured: MeasuredPlatform, points: NDArray) -> NDArray:
    """Return the covariance (B, 6 K, 6 K) of bodies at points (B, K, 3) that the error of the base's pose causes."""
    base = measured.base
    return shared_parent_covariance(base.R, np.nan_to_num(base.p), np.nan_to_num(base.covariance), points)


def _leg_noise(poses: PosesWithCovariance) -> NDArray:
    """Return the covariance (B, 6, 6) of a leg's poses; very wide where the leg was not found."""
    unknown = np.diag([FREE_LENGTH_M**2] * 3 + [FREE_ANGLE_RAD**2] * 3)
    return np.where(poses.found[:, None, None], np.nan_to_num(poses.covariance), unknown)


def prior_of_all(problem: CalibrationProblem, prior: Prior) -> Prior:
    """Return the machine's prior, extended by the unknown survey frames of legs and by errors common to all poses.

    The survey frames have no prior knowledge; common errors have unit standard deviation.
    """
    size, common = len(prior.mean), len(problem.common.entries) if problem.common else 0
    entries = problem.entries[size : len(problem.entries) - common]
    free = np.array([FREE_LENGTH_M if entry.name.startswith("c") else FREE_DIRECTION for entry in entries])
    information = np.diag(np.concatenate([np.zeros(size), free**-2.0, np.ones(common)]))
    information[:size, :size] = prior.information
    return Prior(np.concatenate([prior.mean, problem.start[size:]]), information)


@dataclass(frozen=True)
class Case:
    """A structure model with a deformation model, and the machine of its nominal values."""

    structure: Structure
    deformation: str
    nominal: Machine

    @property
    def key(self) -> tuple[str, str]:
        """Name of structure and deformation in the tables."""
        return self.structure.name, self.deformation


def cases(data: CalibrationData, structures: tuple[Structure, ...]) -> Iterator[Case]:
    """Yield every model that the machine's parameters and the deformation stage allow."""
    for structure in structures:
        for deformation in DEFORMATIONS[:1] if data.modulo_plane else DEFORMATIONS:
            if deformation != "matrix" or "matrix" in data.deformations:
                yield Case(structure, deformation, _deforming(data.machine, deformation, data.deformations))
    if data.in_plane is not None and "matrix" in data.deformations and not data.modulo_plane:
        bent = _deforming(data.machine, "matrix", data.deformations)
        yield Case(structures[0], IN_PLANE, replace(bent, in_plane=np.nan_to_num(data.in_plane.K)))


def _deforming(machine: Machine, deformation: str, known: Mapping[str, Deformation]) -> Machine:
    """Return the machine with the deformation from targets on the attachments, if known."""
    if deformation == "none" or deformation not in known:
        return machine
    return replace(machine, deformation=np.nan_to_num(known[deformation].K))


@dataclass(frozen=True)
class EstimationProblem:
    """A problem over measured poses, the noise (B, N, N) of all measurements, and the prior.

    tolerance (P,): one sigma of each parameter of the machine, NaN where campaign.toml gives none.
    """

    problem: CalibrationProblem
    noise: NDArray
    tolerance: NDArray
    prior: Prior

    @property
    def count(self) -> int:
        """Number of parameters of the machine; survey frames of legs and errors common to all poses follow them."""
        return len(self.problem.parameters)

    @property
    def common(self) -> int:
        """Number of errors common to all poses, which come last."""
        return len(self.problem.common.entries) if self.problem.common else 0


def problem_with_all_parameters(data: CalibrationData, measured: MeasuredPlatform, case: Case) -> EstimationProblem:
    """Return the errors-in-variables problem of platform and readings, with all parameters of the machine free."""
    parameters = free(_every(data, case), data)
    problem, tolerance = problem_of(case, parameters, measured), tolerances(data, case, parameters)
    prior = _prior(data.surveyed, parameters, problem.start, tolerance)
    problem = with_common(problem, measured)
    return EstimationProblem(
        problem, independent_covariance(measured, data.reading_sigma), tolerance, prior_of_all(problem, prior)
    )


def _every(data: CalibrationData, case: Case) -> ParameterSet:
    """Return the parameters of a case; those of flexures only in models that use them, where a tolerance is given."""
    known, model = data.tolerance, case.structure.name
    bends = case.nominal.flexure_length is not None and model in OF_FLEXURES
    return full_set(
        case.nominal,
        case.deformation,
        rho0="rho0" in known,
        flexure_length=bends and "flexure_length" in known,
        beta=bends and model == OF_FLEXURES[0] and "beta" in known and case.nominal.beta is not None,
    )


def nothing_open(data: CalibrationData, case: Case) -> bool:
    """Return True if zero tolerances declare every parameter of a case exact."""
    return not len(free(full_set(case.nominal, case.deformation), data))


def with_targets(
    estimation: EstimationProblem, data: CalibrationData, measured: MeasuredPlatform, case: Case
) -> EstimationProblem | None:
    """Return the problem with measurements of targets on legs and, for a deforming platform, on attachments; None
    without.

    Deformation coefficients then follow from the measured shifts, and have no prior.
    """
    problem = with_bodies(estimation.problem, measured)
    problem = with_shifts(problem, data, measured) if case.deformation != "none" else problem
    if problem is estimation.problem:
        return None
    problem = with_common(problem, measured)
    tolerance, prior = estimation.tolerance, _prior_of_machine(estimation)
    if problem.shifts is not None:
        entries = estimation.problem.parameters.entries  # shifts are measured along z alone
        bent = np.array([is_deformation(entry) and not is_in_plane(entry) for entry in entries])
        tolerance, prior = np.where(bent, np.nan, tolerance), _opened(prior, bent)
    noise = noise_of_all(problem, measured, estimation.noise)
    return EstimationProblem(problem, noise, tolerance, prior_of_all(problem, prior))


def _prior_of_machine(estimation: EstimationProblem) -> Prior:
    """Return the prior of the machine's parameters alone; they are uncorrelated with the rest."""
    return Prior(
        estimation.prior.mean[: estimation.count],
        estimation.prior.information[: estimation.count, : estimation.count],
    )


def is_deformation(entry: LegParameter) -> bool:
    """Return True for coefficients of the platform's deformation."""
    return entry.name == "kappa" or entry.name.startswith("K")


def _opened(prior: Prior, bent: NDArray) -> Prior:
    """Return the prior without knowledge of some parameters (P,), which are independent of the others there."""
    information = prior.information.copy()
    information[bent, bent] = _FREE_DEFORMATION**-2.0
    return Prior(prior.mean, information)


def problem_of(case: Case, parameters: ParameterSet, measured: MeasuredPlatform) -> CalibrationProblem:
    """Return the problem of identifying parameters of a case at measured poses."""
    nominal = under_load(case.nominal, measured)
    return CalibrationProblem(
        case.structure, nominal, parameters, measured.platform.p, measured.platform.R, measured.rho
    )


def observation_covariance(measured: MeasuredPlatform, reading_sigma: float) -> NDArray:
    """Return the covariance (B, 6 + L, 6 + L) of the platform's pose and of the readings."""
    legs = measured.rho.shape[1]
    covariance = np.zeros((len(measured.rho), 6 + legs, 6 + legs))
    covariance[:, :6, :6] = measured.platform.covariance
    covariance[:, 6:, 6:] = np.eye(legs) * reading_sigma**2
    return covariance


def independent_covariance(measured: MeasuredPlatform, reading_sigma: float) -> NDArray:
    """Return that covariance without errors common to all poses, which are unknowns of the problem."""
    covariance = observation_covariance(measured, reading_sigma)
    effects = common_effects(measured)
    covariance[:, :6, :6] -= effects @ np.swapaxes(effects, -1, -2)
    return covariance


def common_effects(measured: MeasuredPlatform) -> NDArray:
    """Return the effects (B, 6, K) of errors common to all poses on the platform's pose."""
    if measured.network is None:
        return np.zeros((len(measured.rho), 6, 0))
    return measured.network.effects[:, :6]


def free(parameters: ParameterSet, data: CalibrationData) -> ParameterSet:
    """Return the parameters without those that a tolerance of zero declares exact."""
    exact = {name for name, sigma in data.tolerance.items() if sigma == 0}
    return ParameterSet(tuple(entry for entry in parameters.entries if kind(entry) not in exact))


def kind(entry: LegParameter) -> str:
    """Return the kind of a parameter, by which tolerances are given: a, b, u, l, rho0, flexure_length, beta."""
    return entry.name if entry.name == "flexure_length" else entry.name.partition("_")[0]


def tolerances(data: CalibrationData, case: Case, parameters: ParameterSet) -> NDArray:
    """Return the prior sigma (P,) of each parameter; NaN where there is none."""
    known = data.deformations.get("matrix" if case.deformation == IN_PLANE else case.deformation)
    spreads = np.full(len(parameters), np.nan)
    for i, entry in enumerate(parameters.entries):
        if kind(entry) in data.tolerance:
            spreads[i] = data.tolerance[kind(entry)]
        elif data.in_plane is not None and is_in_plane(entry):
            spreads[i] = data.in_plane.sigma[entry.leg, "xy".index(entry.name[1]), column_of(entry)]
        elif known is not None and is_deformation(entry):
            spreads[i] = known.sigma[entry.leg, entry.leg if entry.name == "kappa" else column_of(entry)]
    return np.where(spreads > 0, spreads, np.nan)


def widest(parameters: ParameterSet) -> NDArray:
    """Return sigmas (P,) without information, which keep the equations well scaled."""
    wide = dict.fromkeys(("a", "b", "l", "rho0", "flexure_length"), FREE_LENGTH_M) | {"u": FREE_DIRECTION}
    return np.array([wide.get(kind(entry), _FREE_DEFORMATION) for entry in parameters.entries])


def _prior(
    surveyed: SurveyedAttachments | None, parameters: ParameterSet, nominal: NDArray, tolerance: NDArray
) -> Prior:
    """Return the prior of the parameters from tolerances and the survey of the attachments."""
    sigma = np.where(np.isfinite(tolerance), tolerance, widest(parameters))
    information = np.diag(sigma**-2.0)
    if surveyed is None:
        return Prior(nominal, information)
    weighted = information @ nominal
    rows = survey_rows(surveyed, parameters)
    inverse = np.linalg.inv(surveyed.covariance)
    information = information + rows.T @ inverse @ rows
    mean = np.linalg.solve(information, weighted + rows.T @ inverse @ surveyed.b.ravel())
    return Prior(mean, information)


def survey_rows(surveyed: SurveyedAttachments, parameters: ParameterSet) -> NDArray:
    """Return the derivative (3A, P) of the surveyed places of the attachments by the parameters."""
    rows = np.zeros((3 * len(surveyed.legs), len(parameters)))
    for i, entry in enumerate(parameters.entries):
        if entry.name.startswith("b_"):
            indices = np.flatnonzero(surveyed.legs == entry.leg)
            rows[3 * indices + "xyz".index(entry.name[2]), i] = 1.0
    return rows
