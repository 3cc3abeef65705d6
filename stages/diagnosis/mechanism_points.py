"""From a run's tables to what the diagnosis compares: measured points of all bodies, and the model of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import exp_so3
from truing.inference.observations import Epochs, Frames, Observations
from truing.report.numbers import count as counted
from truing.simulation.cause import Cause
from truing.simulation.inputs import ORDER
from truing.simulation.mechanisms.causes.targets import TargetsSwapped
from truing.simulation.mechanisms.extended_model import some_of
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.model import Known, PointModel, nominal_leg_frames
from truing.simulation.mechanisms.recording import FREE_DIRECTION, FREE_LENGTH_M, Conditions
from truing.simulation.targets import BASE, LEG, PLATFORM, Targets, shape_unknowns
from truing.stages.common.nominal_mechanism import facing, nominal_legs
from truing.stages.common.point_arrays import number_column, pose_ids, pose_points, positions, survey_points
from truing.stages.common.pose_conditions import pose_conditions
from truing.stages.diagnosis.judged_points import judged_points, swapped_targets
from truing.stages.diagnosis.shown import Channels

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.selection import Diagnosis
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism
Leaves = Callable[["Diagnosis", Channels, "Campaign"], dict[str, Any]]


@dataclass(frozen=True)
class Gathered:
    """Measured points and readings by role, the model of the plain simulation, and what was left out, in words."""

    model: Any  # a `CampaignModel`
    calibration: Epochs
    held_out: Epochs | None
    left_out: str
    framing: int | None  # platform targets that sit on no attachment; None where there is no mechanism
    given: tuple[Cause, ...] = ()  # causes that are certain before any search: labels that were exchanged
    shown: Channels | None = None  # the channels of readings, which have units of their own; None where all are points
    leaves: Leaves | None = None  # what its instrument leaves, where `artifacts_of` does not know that


@dataclass(frozen=True)
class _Bodies:
    """All bodies' targets one after the other."""

    targets: Targets
    shape: NDArray  # (K, 3) m
    shape_cov: NDArray  # (K, 3, 3) m^2
    points: NDArray  # (B, K, 3) m
    cov: NDArray  # (B, K, 3, 3) m^2
    seen: NDArray  # (B, K)
    swapped: tuple[TargetsSwapped, ...]


@dataclass(frozen=True)
class _Prior:
    """One standard deviation of the geometry (m, rad) and of a reading (m), and what else is declared."""

    geometry: dict[str, float]
    reading: float
    open: tuple[str, ...]  # of a, b, u, l: those that campaign.toml gives no tolerance for
    reference_temperature_c: float
    pitch: float | None  # m, of the leadscrews
    flexure_length: float | None  # m


def _prior(section: LeggedMechanism, reading_mm: float) -> _Prior:
    """What campaign.toml knows beforehand; wide open where it gives no tolerance."""
    tolerance = section.tolerance
    given = {"a": tolerance.a_mm, "b": tolerance.b_mm, "l": tolerance.length_mm}
    sigmas = {name: FREE_LENGTH_M if value is None else value * 1e-3 for name, value in given.items()}
    if "u" in nominal_legs(section).closure.geometry:
        given["u"] = tolerance.u
        sigmas["u"] = FREE_DIRECTION if tolerance.u is None else tolerance.u
    flexures = [leg.flexure_length_mm for leg in section.legs if leg.flexure_length_mm is not None]
    return _Prior(
        sigmas,
        reading_mm * 1e-3,
        tuple(name for name, value in given.items() if value is None),
        section.reference_temperature_c,
        None if section.actuator_pitch_mm is None else section.actuator_pitch_mm * 1e-3,
        float(np.mean(flexures)) * 1e-3 if len(flexures) == len(section.legs) else None,
    )


def gather(tables: Mapping[str, pa.Table], settings: Campaign) -> Gathered:
    """Return what the diagnosis compares; raises ValueError, saying why, where the campaign does not hold it."""
    section = cast("LeggedMechanism", settings.mechanism)
    legs = facing(nominal_legs(section), tables["poses"])
    poses = pose_ids(tables["configurations"])
    conditions = pose_conditions(tables["configurations"], poses, legs.count, settings.noise.actuator_mm * 1e-3)
    bodies = _bodies(tables, poses, legs.count, settings, conditions.covariates[ORDER])
    if not np.any(bodies.targets.body == BASE) or not np.any(bodies.targets.body == PLATFORM):
        raise ValueError("needs surveyed targets on base and platform")
    frames = _base_frames(tables["poses"], poses)
    usable = np.isfinite(conditions.readings).all(1) & np.isfinite(frames.t).all(1)
    role = _roles(tables["configurations"], poses)
    fitted, held = usable & (role != "verification"), usable & (role == "verification")
    if fitted.sum() < 3:
        raise ValueError(f"needs at least 3 poses with readings and a base, found {int(fitted.sum())}")
    prior = _prior(section, settings.noise.actuator_mm)
    model, bodies, dropped = _model(legs, bodies, conditions, frames, fitted, prior)
    words = [f"{counted(int((~usable).sum()), 'pose')} without readings or base"] if not usable.all() else []
    return Gathered(
        model.at(some_of(conditions, fitted)),
        _poses(bodies, conditions, frames, fitted),
        _poses(bodies, conditions, frames, held) if held.any() else None,
        "; ".join([*words, *dropped]),
        int(np.sum((bodies.targets.body == PLATFORM) & (bodies.targets.leg < 0))),
        bodies.swapped,
    )


def _bodies(
    tables: Mapping[str, pa.Table], poses: tuple[int | str, ...], legs: int, settings: Campaign, order: NDArray
) -> _Bodies:
    noise = (settings.noise.point_mm or 0.0) * 1e-3
    kinds = [("base", BASE, -1), ("platform", PLATFORM, -1), *((f"leg{i + 1}", LEG, i) for i in range(legs))]
    parts: dict[str, list[Any]] = {name: [] for name in ("body", "leg", "shape", "shape_cov", "points", "cov", "seen")}
    named: list[tuple[str, str]] = []
    swapped: list[TargetsSwapped] = []
    for body, kind, ridden in kinds:
        survey = survey_points(tables["survey"], body)
        found = pose_points(tables["observations"], body, poses, survey.targets)
        judged = judged_points(tables["residuals"], body, found, survey.points, order)
        swapped += swapped_targets(body, survey.targets, poses, order, judged.exchanges)
        named += [(body, target) for target in survey.targets]
        parts["body"].append(np.full(len(survey.targets), kind))
        parts["leg"].append(survey.leg - 1 if kind == PLATFORM else np.full(len(survey.targets), ridden))
        for name, value in (
            ("shape", survey.points),
            ("shape_cov", _filled(survey.cov, noise)),
            ("points", found.points),
            ("cov", _filled(found.cov, noise)),
            ("seen", judged.kept),
        ):
            parts[name].append(value)
    joined = {
        name: np.concatenate(values, 0 if name in ("body", "leg", "shape", "shape_cov") else 1)
        for name, values in parts.items()
    }
    names, carriers = tuple(target for _, target in named), tuple(body for body, _ in named)
    return _Bodies(Targets(joined.pop("body"), joined.pop("leg"), names, carriers), **joined, swapped=tuple(swapped))


def _filled(cov: NDArray, noise: float) -> NDArray:
    """Return covariances with the declared noise where a point carries none."""
    known = np.isfinite(cov).all((-1, -2)) & (np.trace(np.nan_to_num(cov), axis1=-2, axis2=-1) > 0)
    return np.where(known[..., None, None], cov, np.eye(3) * noise**2)


def _base_frames(table: pa.Table, poses: tuple[int | str, ...]) -> Frames:
    """Frames from the base to the measurement; NaN where the base of a pose was not found."""
    import pyarrow.compute as pc

    rows = table.filter(pc.and_(table.column("default"), pc.equal(table.column("body"), "base")))
    place = positions(rows.column("pose"), poses)
    vector, t = np.zeros((len(poses), 3)), np.full((len(poses), 3), np.nan)
    t[place[place >= 0]] = np.column_stack([number_column(rows, f"p{a}_mm") for a in "xyz"])[place >= 0] * 1e-3
    vector[place[place >= 0]] = np.column_stack([number_column(rows, f"r{a}_rad") for a in "xyz"])[place >= 0]
    return Frames(exp_so3(np.nan_to_num(vector)), t)


def _roles(configurations: pa.Table, poses: tuple[int | str, ...]) -> NDArray:
    place = positions(configurations.column("pose"), poses)
    roles = np.full(len(poses), "", object)
    roles[place] = configurations.column("role").to_pylist()
    return roles


def _poses(bodies: _Bodies, conditions: Conditions, frames: Frames, rows: NDArray) -> Epochs:
    measured = Observations(bodies.points[rows], bodies.cov[rows], bodies.seen[rows])
    return Epochs(measured, some_of(conditions, rows), Frames(frames.R[rows], frames.t[rows]))


def _model(
    legs: Legs, bodies: _Bodies, conditions: Conditions, frames: Frames, fitted: NDArray, prior: _Prior
) -> tuple[PointModel, _Bodies, list[str]]:
    """Return the plain model; legs whose targets do not fix them are left out, with the reason."""
    seats = _leg_motions(legs, bodies, frames, fitted)
    carrying = {int(leg) for leg in bodies.targets.leg[bodies.targets.body == LEG]}
    ridden = [leg for leg in seats if legs.closure.one_body]
    dropped = [f"targets of leg{leg + 1} (fewer than three seen together off a line)" for leg in carrying - set(seats)]
    dropped += ["targets on legs, which are not one rigid body each"] if len(seats) > len(ridden) else []
    bodies = _subset(bodies, (bodies.targets.body != LEG) | np.isin(bodies.targets.leg, ridden))
    rotation, seat = np.tile(np.eye(3), (legs.count, 1, 1)), np.zeros((legs.count, 3))
    for leg in ridden:
        pose, R, t = seats[leg]
        frame = nominal_leg_frames(legs, conditions.readings[pose][None])
        rotation[leg] = frame.rotation[0, leg].T @ R
        seat[leg] = frame.rotation[0, leg].T @ (t - frame.origin[0, leg])
    survey = shape_unknowns(bodies.targets, bodies.shape, bodies.shape_cov)
    known = Known(
        prior.geometry,
        bodies.shape,
        survey,
        prior.reading,
        np.array(ridden, int),
        rotation,
        seat,
        prior.open,
        prior.reference_temperature_c,
        prior.pitch,
        prior.flexure_length,
    )
    return PointModel(bodies.targets, conditions, legs, known), bodies, dropped


def _leg_motions(
    legs: Legs, bodies: _Bodies, frames: Frames, fitted: NDArray
) -> dict[int, tuple[int, NDArray, NDArray]]:
    """Return, by leg, its best measured pose and the motion from its survey to the base there."""
    in_base = (bodies.points - np.nan_to_num(frames.t)[:, None]) @ frames.R
    found = {}
    for leg in range(legs.count):
        own = (bodies.targets.body == LEG) & (bodies.targets.leg == leg)
        if own.sum() < 3:
            continue
        fit = umeyama(bodies.shape[own], in_base[:, own], (bodies.seen[:, own] & fitted[:, None]).astype(float))
        best = int(np.argmax(np.where(fit.ok, fit.n_used - np.nan_to_num(fit.rms), -1.0)))
        if fit.ok[best]:
            found[leg] = best, fit.R[best], fit.t[best]
    return found


def _subset(bodies: _Bodies, kept: NDArray) -> _Bodies:
    own = bodies.targets
    names = [tuple(np.array(values, object)[kept]) for values in (own.names, own.bodies)]
    targets = Targets(own.body[kept], own.leg[kept], names[0], names[1])
    return _Bodies(
        targets,
        bodies.shape[kept],
        bodies.shape_cov[kept],
        bodies.points[:, kept],
        bodies.cov[:, kept],
        bodies.seen[:, kept],
        tuple(cause for cause in bodies.swapped if cause.body in targets.bodies),
    )
