"""Poses of a second campaign, predicted by the nominal, the calibrated and the extended model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.calibration.accuracy import ARCSEC, PoseErrors, errors_at, machine_errors
from truing.schemas.covariates import own_name
from truing.simulation.mechanisms.extended_model import (
    ExtendedModel,
    acts_on_poses,
    persistent_part,
    read_model,
    some_of,
)
from truing.simulation.mechanisms.parameters import ParameterSet, full_set
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.simulation.mechanisms.structures.structure import Machine, Structure
from truing.stages.common.calibration_data import assemble
from truing.stages.common.point_arrays import pose_ids
from truing.stages.common.pose_conditions import pose_conditions
from truing.stages.second_campaign.compared import CALIBRATED, EXTENDED, NOMINAL, PredictionErrors, SecondCampaign

if TYPE_CHECKING:
    from truing.calibration.calibration_input import CalibrationData
    from truing.simulation.mechanisms.recording import Conditions

_SAME_M = 1e-7
_ML = "errors-in-variables"


def predicted_poses(text: str, tables: Mapping[str, pa.Table], second: SecondCampaign) -> Iterator[PredictionErrors]:
    """Yield errors of positions (um) and orientations (arcsec) by every model.

    text: the extended model; tables: ``calibration`` and ``model_choice`` of its campaign, where there are any. Raises
    CampaignFaults where the second campaign is of another machine, ValueError where it holds no pose.
    """
    model = persistent_part(read_model(text))
    if not second.settings.mechanism.is_legged:
        raise second.refuse("mechanism.type", model.model.nominal.closure.name, second.settings.mechanism.type)
    data = assemble(second.tables, second.settings)
    _check(model, data, second)
    rigid, *_ = structures(data.machine)
    noise = data.reading_sigma
    every: list[tuple[str, str, PoseErrors]] = [
        (NOMINAL, rigid.name, machine_errors(rigid, data.machine, data.measured, noise))
    ]
    calibrated = _calibrated(tables, data.machine)
    if calibrated is not None:
        name, structure, machine = calibrated
        every.append((CALIBRATED, name, machine_errors(structure, machine, data.measured, noise)))
    conditions = _conditions(model, data, second)
    nowhere = np.zeros(len(data.measured.rho), bool)
    every.append((EXTENDED, _causes(model), errors_at(model, conditions, data.measured, nowhere)))
    for by, name, errors in every:
        expected = every[0][2].expected
        for quantity, size, first, unit, si in (
            ("position", errors.position, 0, "um", 1e-6),
            ("orientation", errors.orientation, 3, "arcsec", ARCSEC),
        ):
            noise_rms = float(np.sqrt(np.mean(expected(first) ** 2))) / si
            yield PredictionErrors(by, name, quantity, unit, size / si, noise_rms)


def _check(model: ExtendedModel, data: CalibrationData, second: SecondCampaign) -> None:
    """Raise CampaignFaults where the nominal legs are not those of the model."""
    nominal, legs = model.model.nominal, data.machine.legs
    if nominal.closure.name != legs.closure.name:
        raise second.refuse("mechanism.type", nominal.closure.name, legs.closure.name)
    if nominal.count != legs.count:
        raise second.refuse("mechanism.legs", f"{nominal.count} legs, as the model has", f"{legs.count} legs")
    for name in ("a", "b", "l", "rho0"):
        first, two = getattr(nominal, name), getattr(legs, name)
        difference = np.abs(first - two).reshape(nominal.count, -1).max(1)
        if difference.max() > _SAME_M:
            leg = int(np.argmax(difference)) + 1
            key = {"l": "length_mm", "rho0": "rho0_mm"}.get(name, f"{name}_mm")
            expected = f"the nominal {key} of the model: that of leg {leg} differs by {1e3 * difference.max():.4g} mm"
            raise second.refuse(f"mechanism.legs.{leg}.{key}", expected)


def _calibrated(tables: Mapping[str, pa.Table], nominal: Machine) -> tuple[str, Structure, Machine] | None:
    """The chosen calibration's name, its structure and its machine; None where none was chosen."""
    choice, identified = tables.get("model_choice"), tables.get("calibration")
    chosen = [
        (row["model"], row["deformation"])
        for row in ([] if choice is None else choice.to_pylist())
        if (row["estimator"], row["figure"], row["value"]) == (_ML, "chosen", 1.0)
    ]
    structure = next((one for one in structures(nominal) if chosen and one.name == chosen[0][0]), None)
    if structure is None or identified is None:
        return None
    rows_of_model = [row for row in identified.to_pylist() if (row["model"], row["deformation"]) == chosen[0]]
    values_by_leg = {(row["parameter"], row["leg"]): row["identified"] for row in rows_of_model}
    count = nominal.legs.count
    start = replace(nominal, deformation=np.zeros((count, count)), in_plane=np.zeros((count, 2, count)))
    every = full_set(start, chosen[0][1], rho0=True)
    parameters = ParameterSet(tuple(e for e in every.entries if (e.name, e.leg_number) in values_by_leg))
    values = np.array([values_by_leg[e.name, e.leg_number] for e in parameters.entries], float) * parameters.units
    return " ".join(chosen[0]), structure, parameters.machine(start, values)


def _conditions(model: ExtendedModel, data: CalibrationData, second: SecondCampaign) -> Conditions:
    """Conditions of the measured poses; raises ValueError where a column is missing that an effect follows."""
    poses = pose_ids(second.tables["configurations"])
    legs, sigma = model.model.nominal.count, model.model.known.reading_sigma
    conditions = pose_conditions(second.tables["configurations"], poses, legs, sigma)
    needed = {name for cause in model.model.causes if acts_on_poses(cause) for name in cause.needs(legs)}
    if missing := sorted(
        own_name(name) for name in needed - conditions.covariates.keys() if not name.startswith("rho")
    ):
        raise ValueError(f"the extended model follows {', '.join(missing)}, which the second campaign does not hold")
    index_of = {pose: n for n, pose in enumerate(poses)}
    return some_of(conditions, np.array([index_of[pose] for pose in data.measured.poses], int))


def _causes(model: ExtendedModel) -> str:
    """Return the causes of the extended model in words, for the tables."""
    names = dict.fromkeys(cause.id for cause in model.model.causes)
    return f"with {', '.join(names)}" if names else "no effect that lasts"
