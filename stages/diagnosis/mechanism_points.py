"""Data of the diagnosis of a legged mechanism: measured points of all bodies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.estimation.labels.point_selection import select_points
from truing.estimation.rigid_poses.points import PointResiduals, PosePoints, with_declared_noise
from truing.inference.observations import Frames
from truing.report.numbers import count_text
from truing.simulation.inputs import APPROACH, ORDER, TIME
from truing.simulation.mechanisms.causes.targets import TargetsSwapped, swapped_targets
from truing.simulation.mechanisms.extended_model import extended, some_of, write_model
from truing.simulation.mechanisms.legs.kinematics import reaches
from truing.simulation.mechanisms.measured_mechanism import MeasuredTargets, SeatedLegs, seated_legs
from truing.simulation.mechanisms.model import MechanismModel, PriorKnowledge
from truing.simulation.targets import BASE, FREE_DIRECTION, FREE_LENGTH_M, LEG, PLATFORM, Targets, shape_unknowns
from truing.stages.common.blocks import groupings_of, labels_of, repeats_of, selected_groupings
from truing.stages.common.external_load import weight_of
from truing.stages.common.missing_data import HELD_OUT, why_no_diagnosis_of_mechanism
from truing.stages.common.nominal_mechanism import facing, nominal_legs
from truing.stages.common.point_arrays import (
    default_motions,
    default_rotations,
    point_residuals,
    pose_ids,
    pose_points,
    roles_of,
    survey_points,
)
from truing.stages.common.pose_conditions import pose_conditions
from truing.stages.diagnosis.diagnosis_data import DiagnosisData, InstrumentResults, IsolatedPoint
from truing.stages.diagnosis.next_measurement import next_of
from truing.stages.diagnosis.prior_campaign import changes_table
from truing.stages.diagnosis.residual_tables import prediction_table, pull_tables

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.inference.selection import CauseDiagnosis
    from truing.schemas.campaign import Campaign
    from truing.schemas.mechanism import LeggedMechanism
    from truing.simulation.effects_model import EffectsModel

_FEWEST_POSES = 3


def assemble(tables: Mapping[str, pa.Table], settings: Campaign) -> DiagnosisData[MechanismModel]:
    """Data of the diagnosis; raises ValueError with the reason if the campaign lacks them."""
    section = cast("LeggedMechanism", settings.mechanism)
    if why := why_no_diagnosis_of_mechanism(section, settings.noise.point_mm, tables):
        raise ValueError(why)
    legs = facing(nominal_legs(section), tables["poses"])
    poses = pose_ids(tables["configurations"])
    conditions = pose_conditions(tables["configurations"], poses, legs.count, settings.noise.actuator_mm * 1e-3)
    bodies, isolated = _targets(tables, poses, legs.count, settings, conditions.covariates[ORDER])
    if not np.any(bodies.targets.body == BASE) or not np.any(bodies.targets.body == PLATFORM):
        raise ValueError("needs surveyed targets on base and platform")
    base = Frames(default_rotations(tables["poses"], "base", poses), default_motions(tables["poses"], "base", poses)[1])
    usable = np.isfinite(conditions.readings).all(1) & np.isfinite(base.t).all(1)
    role = roles_of(tables["configurations"], poses)
    fitted, held_out = usable & (role != HELD_OUT), usable & (role == HELD_OUT)
    if fitted.sum() < _FEWEST_POSES:
        raise ValueError(f"needs at least {_FEWEST_POSES} poses with readings and a base, found {int(fitted.sum())}")
    seated = seated_legs(legs, bodies, conditions.readings, base, fitted)
    bodies = bodies.subset(seated.targets_on_legs(bodies.targets))
    model = MechanismModel(
        bodies.targets, some_of(conditions, fitted), legs, _prior_knowledge(section, settings, bodies, seated)
    )
    if unreached := int((~reaches(legs, conditions.readings[fitted])).sum()):
        raise ValueError(
            f"the legs of [mechanism] cannot meet the platform at the readings of {unreached} of "
            f"{count_text(int(fitted.sum()), 'pose')}"
        )
    words = [f"{count_text(int((~usable).sum()), 'pose')} without readings or base"] if not usable.all() else []
    repeats = repeats_of(tables["configurations"], poses, (), settings.noise.actuator_mm)
    fitted_conditions, known_groupings = (
        some_of(conditions, fitted),
        selected_groupings(labels_of(tables["configurations"], poses), fitted),
    )
    groupings = groupings_of(
        fitted_conditions.readings,
        fitted_conditions.covariates.get(TIME),
        fitted_conditions.covariates.get(APPROACH),
        known_groupings,
    )
    return DiagnosisData(
        model,
        replace(
            bodies.epochs(conditions, base, fitted),
            repeats=None if repeats is None else repeats[fitted],
            groupings=groupings,
        ),
        bodies.epochs(conditions, base, held_out) if held_out.any() else None,
        "; ".join([*words, *seated.dropped]),
        _results,
        bodies.swapped,
        model_text=_model_text,
        is_calibrated=lambda cause: True,
        isolated=isolated,
        framing=int(np.sum((bodies.targets.body == PLATFORM) & (bodies.targets.leg < 0))),
    )


def _prior_knowledge(
    section: LeggedMechanism, settings: Campaign, bodies: MeasuredTargets, seated: SeatedLegs
) -> PriorKnowledge:
    """Prior from campaign.toml and survey; wide where they give no tolerance."""
    tolerance = section.tolerance
    given = {"a": tolerance.a_mm, "b": tolerance.b_mm, "l": tolerance.length_mm}
    sigmas = {name: FREE_LENGTH_M if value is None else value * 1e-3 for name, value in given.items()}
    if "u" in nominal_legs(section).closure.geometry:
        given["u"] = tolerance.u
        sigmas["u"] = FREE_DIRECTION if tolerance.u is None else tolerance.u
    flexures = [leg.flexure_length_mm for leg in section.legs if leg.flexure_length_mm is not None]
    return PriorKnowledge(
        sigmas,
        bodies.shape,
        shape_unknowns(bodies.targets, bodies.shape, bodies.shape_cov),
        settings.noise.actuator_mm * 1e-3,
        seated.legs,
        seated.rotation,
        seated.seat,
        tuple(name for name, value in given.items() if value is None),
        section.reference_temperature_c,
        None if section.actuator_pitch_mm is None else section.actuator_pitch_mm * 1e-3,
        float(np.mean(flexures)) * 1e-3 if len(flexures) == len(section.legs) else None,
        weight_of(section, settings),
    )


def _targets(
    tables: Mapping[str, pa.Table], poses: tuple[int | str, ...], legs: int, settings: Campaign, order: NDArray
) -> tuple[MeasuredTargets, tuple[IsolatedPoint, ...]]:
    """Targets of all bodies, and the points left out that the fit of poses did not reject before."""
    noise = (settings.noise.point_mm or 0.0) * 1e-3
    kinds = [("base", BASE, -1), ("platform", PLATFORM, -1), *((f"leg{i + 1}", LEG, i) for i in range(legs))]
    parts: dict[str, list[Any]] = {
        name: [] for name in ("body", "leg", "shape", "shape_cov", "points", "cov", "is_observed")
    }
    named: list[tuple[str, str]] = []
    swapped: list[TargetsSwapped] = []
    isolated: list[IsolatedPoint] = []
    for body, kind, ridden in kinds:
        survey = survey_points(tables["survey"], body)
        points = pose_points(tables["observations"], body, poses, survey.targets)
        residuals = point_residuals(tables["residuals"], body, poses, survey.targets)
        assessed = select_points(residuals, points, survey.points, order)
        isolated += _isolated_points(body, points, residuals, assessed.kept)
        swapped += swapped_targets(body, survey.targets, poses, order, assessed.exchanges)
        named += [(body, target) for target in survey.targets]
        parts["body"].append(np.full(len(survey.targets), kind))
        parts["leg"].append(survey.leg - 1 if kind == PLATFORM else np.full(len(survey.targets), ridden))
        for name, value in (
            ("shape", survey.points),
            ("shape_cov", with_declared_noise(survey.cov, noise)),
            ("points", points.points),
            ("cov", with_declared_noise(points.cov, noise)),
            ("is_observed", assessed.kept),
        ):
            parts[name].append(value)
    joined = {
        name: np.concatenate(values, 0 if name in ("body", "leg", "shape", "shape_cov") else 1)
        for name, values in parts.items()
    }
    names, carriers = tuple(target for _, target in named), tuple(body for body, _ in named)
    targets = Targets(joined.pop("body"), joined.pop("leg"), names, carriers)
    return MeasuredTargets(targets, **joined, swapped=tuple(swapped)), tuple(isolated)


def _isolated_points(
    body: str, points: PosePoints, residuals: PointResiduals, is_kept: NDArray
) -> Iterator[IsolatedPoint]:
    """Yield the points (B, T) that are neither kept nor rejected by the fit of poses nor excluded by a person."""
    for pose, target in np.argwhere(points.is_observed & ~is_kept & ~residuals.rejected & ~residuals.excluded):
        distance = float(np.linalg.norm(residuals.values[pose, target]))
        yield IsolatedPoint(points.poses[pose], f"{body} {points.targets[target]}", distance)


def _model_text(fitted: FittedModel, settings: Campaign) -> str:
    """The extended model of a fit, as model.toml has it."""
    assert isinstance(fitted.model, MechanismModel)
    context = {"campaign": settings.campaign.name}
    return write_model(extended(fitted.model, fitted.fit.shared, fitted.covariance(), context))


def _results(diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel], settings: Campaign) -> InstrumentResults:
    """Errors of each pose, extended model, pulls of the geometry, changes, next measurements."""
    final = diagnosis.final
    next_measurement = next_of(diagnosis, settings)
    left = {
        "prediction": prediction_table(diagnosis, data),
        "model": _model_text(final, settings),
        **pull_tables(diagnosis.plain, final),
        "changes": changes_table(final),
        "next_poses": next_measurement.table,
    }
    return InstrumentResults(left, next_measurement.advice)
