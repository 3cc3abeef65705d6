"""Problem of choosing configurations from campaign.toml: region, regressors in tolerances and noise, names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.calibration.configuration_search import ConfigurationLimits, DesignProblem, identifiable_parameters
from truing.estimation.design.feasible_region import FeasibleRegion
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import skew
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.near_names import did_you_mean
from truing.simulation.change import Change
from truing.simulation.mechanisms.parameters import LegParameter, ParameterSet, full_set
from truing.simulation.mechanisms.pose_regressors import PoseRegressors, pose_regressors
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.simulation.mechanisms.structures.structure import Machine
from truing.stages.common.chain_candidates import given_numbers
from truing.stages.common.nominal_mechanism import FILE, plain_machine
from truing.stages.common.point_arrays import survey_points

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism, Tolerance

_POSE = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
_TO_SI = np.array([1e-3] * 3 + [np.pi / 180.0] * 3)
# Default tolerances; they only set the scale for the numerical rank.
_FREE = {"mm": 1e-3, "1": 1e-2}


def design_problem(
    settings: Campaign, limits: ConfigurationLimits, parameters: Sequence[str], survey: pa.Table | None
) -> DesignProblem:
    """Return the problem of choosing configurations for some parameters of each leg, or for all separable ones.

    Raises CampaignFaults for an incomplete campaign or unknown parameters, ValueError if forbidden regions leave no
    candidate.
    """
    section = cast("LeggedMechanism", settings.mechanism)
    machine = plain_machine(settings)
    parameter_set = full_set(machine, "none")
    problem = problem_of(machine, limits, parameter_set)
    structure = problem.regressors.structure
    names = tuple(replace(entry, leg=0) for entry in parameter_set.entries if entry.leg == 0)
    tolerance = np.array([_tolerance(section.tolerance, entry) for entry in names])
    noise, noise_from = _residual_noise(settings, problem.regressors, survey)
    problem = replace(problem, names=names, tolerance=tolerance, noise=noise, noise_from=noise_from)
    chosen_places = _parameter_indices(names, parameters) if parameters else identifiable_parameters(problem)
    chosen = ParameterSet(
        tuple(
            entry for k in chosen_places for entry in parameter_set.entries[k * problem.legs : (k + 1) * problem.legs]
        )
    )
    narrowed = pose_regressors(structure, machine, chosen, limits.pose, limits.readings)
    fixed_names = tuple(entry.name for k, entry in enumerate(names) if k not in chosen_places)
    chosen_names = tuple(names[k] for k in chosen_places)
    return replace(
        problem, regressors=narrowed, names=chosen_names, tolerance=tolerance[chosen_places], held=fixed_names
    )


def problem_of(machine: Machine, limits: ConfigurationLimits, parameters: ParameterSet) -> DesignProblem:
    """Return the region of configurations and the regressors of parameters, without names, tolerances and noise.

    Raises CampaignFaults if the limits leave a displacement unbounded.
    """
    structure = KinematicModel(machine.legs.closure.name)
    try:
        regressors = pose_regressors(structure, machine, parameters, limits.pose, limits.readings)
    except ValueError as error:
        needed_limits = "rho_mm, or, without --within actuators, all of x_mm y_mm z_mm rx_deg ry_deg rz_deg"
        raise CampaignFaults([Fault(FILE, f"{error}: {needed_limits}", column="workspace")]) from None
    half = np.concatenate([limits.pose, limits.readings])
    region = FeasibleRegion(6, regressors.quantities, half, limits.lower, limits.upper)
    return DesignProblem(regressors, region, (), np.zeros(0), np.ones(machine.legs.count), "")


def limits_of(settings: Campaign, *, pose_too: bool, avoid: pa.Table | None, avoid_file: str) -> ConfigurationLimits:
    """Return the limits of [workspace], those of the pose only if wanted, and the boxes of a table to avoid.

    Raises CampaignFaults for a table without such boxes.
    """
    legs = plain_machine(settings).legs
    workspace = settings.workspace
    pose = np.array([getattr(workspace, name) or np.inf for name in _POSE]) * _TO_SI
    pose = pose if pose_too else np.full(6, np.inf)
    readings = np.full(legs.count, (workspace.rho_mm or np.inf) * 1e-3)
    bounds = np.stack(
        [np.full((0 if avoid is None else len(avoid), 6 + legs.count), sign * np.inf) for sign in (-1, 1)]
    )
    if avoid is not None:
        _fill_boxes(bounds, avoid, legs.rho0, avoid_file)
    return ConfigurationLimits(pose, readings, *bounds)


def _fill_boxes(bounds: NDArray, avoid: pa.Table, rho0: NDArray, file: str) -> None:
    """Enter columns such as x_min_mm, rx_max_deg and rho1_max_mm; an empty cell leaves the side open."""
    stems = [*_POSE, *(f"rho{leg + 1}_mm" for leg in range(len(rho0)))]
    known = {
        stem.replace("_", f"_{side}_"): (s, k) for k, stem in enumerate(stems) for s, side in enumerate(("min", "max"))
    }
    unknown = [name for name in avoid.schema.names if name not in known]
    if unknown or not len(avoid):
        expected = f"rows of forbidden regions, columns of {', '.join(list(known)[:2])} .. {list(known)[-1]}"
        raise CampaignFaults(Fault(file, expected, column=name) for name in unknown or [None])
    for name in avoid.schema.names:
        side, k = known[name]
        factor, zero = (_TO_SI[k], 0.0) if k < 6 else (1e-3, rho0[k - 6])
        values = given_numbers(avoid, name, file) * factor - zero
        bounds[side, :, k] = np.where(np.isnan(values), bounds[side, :, k], values)
    _check_boxes(bounds, file)


def _check_boxes(bounds: NDArray, file: str) -> None:
    empty = np.flatnonzero(np.any(bounds[0] >= bounds[1], -1) | np.all(np.isinf(bounds), (0, 2)))
    if len(empty):
        expected = "a forbidden region with each minimum below its maximum, and at least one of them"
        raise CampaignFaults(Fault(file, expected, row=int(row) + 2) for row in empty)


def _tolerance(section: Tolerance, entry: LegParameter) -> float:
    """Return one sigma of manufacturing, SI."""
    tolerances = {"a": section.a_mm, "b": section.b_mm, "l": section.length_mm, "u": section.u}[entry.name[0]]
    return tolerances * entry.si if tolerances else _FREE[entry.unit]


def _parameter_indices(names: tuple[LegParameter, ...], wanted: Sequence[str]) -> list[int]:
    known = [entry.name for entry in names]
    unknown = [name for name in wanted if name not in known]
    if unknown:
        known_text = ", ".join(known)
        raise CampaignFaults(
            Fault("--parameters", f"parameters of a leg: {known_text}{did_you_mean(name, known)}", value=name)
            for name in unknown
        )
    return [k for k, name in enumerate(known) if name in wanted]


def _residual_noise(settings: Campaign, regressors: PoseRegressors, survey: pa.Table | None) -> tuple[NDArray, str]:
    """Return one sigma (L,), m, of the legs' residuals at the reference pose, and its source in words."""
    point, reading = (settings.noise.point_mm or 0.0) * 1e-3, settings.noise.actuator_mm * 1e-3
    pose, machine = regressors.reference, regressors.machine
    closing = regressors.structure.close(machine, pose.p, pose.R, np.atleast_2d(machine.legs.rho0), Change({}, 0))
    derivative = reading * np.diagonal(closing.by_rho[0])
    covariance = None if survey is None or not point else _pose_covariance(survey, pose.p[0], pose.R[0], point)
    if covariance is not None:
        seen = np.einsum("li,ij,lj->l", closing.by_twist[0], covariance, closing.by_twist[0])
        return np.sqrt(seen + derivative**2), "noise of points on the surveyed targets, and of readings"
    if point or reading:
        return np.sqrt(point**2 + derivative**2), "noise.point_mm on every leg, and that of readings"
    return np.full(machine.legs.count, 1e-6), "1 um on every leg, because campaign.toml gives no noise"


def _pose_covariance(survey: pa.Table, p: NDArray, R: NDArray, sigma: float) -> NDArray | None:
    """Return the covariance (6, 6) of the platform in the base from points of noise sigma, at a pose; None without."""
    parts = []
    for body in ("platform", "base"):
        points = survey_points(survey, body)
        frame = points.points[points.leg == 0]
        fit = umeyama(frame, frame[None], sigma=sigma) if len(frame) >= 3 else None
        if fit is None or not fit.ok[0]:
            return None
        parts.append(fit.covariance[0])
    turned, lever = np.kron(np.eye(2), R), np.eye(6)
    lever[:3, 3:] = -skew(p)
    return turned @ parts[0] @ turned.T + lever @ parts[1] @ lever.T
