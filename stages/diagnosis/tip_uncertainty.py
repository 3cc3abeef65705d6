"""Uncertainty of the predicted poses of a chain's tip, by source."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.arrays import Array, TableRow
from truing.estimation.rotation import left_jacobian_so3, log_so3
from truing.inference.variance_sources import Contribution
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.chains.conditions import ChainConditions
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain, extended_chain, predict_tip, tip_by_joints
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.stages.diagnosis.cause_tables import source_of

if TYPE_CHECKING:
    from truing.inference.fitted_model import FittedModel
    from truing.schemas.campaign import Campaign

_MM, _DEG = 1e-3, np.pi / 180.0
# Poses of the campaign for which budgets are made, evenly over it.
_MOST = 50
_OWN_READINGS: TableRow = {
    "input_source": "readings of the joints in the predicted pose",
    "evaluation": "B",
    "degrees_of_freedom": None,
}
_COMPONENTS = {"px": "mm", "py": "mm", "pz": "mm", "rx": "rad", "ry": "rad", "rz": "rad"}


def tip_contributions(
    final: FittedModel, conditions: ChainConditions, reading_sigma: NDArray
) -> tuple[ExtendedChain, list[tuple[Contribution | None, Array]]]:
    """Covariance (B, 6, 6), m and rad, of the tip's predicted poses in the base by each source, and the model.

    ``reading_sigma`` (n,): noise of the readings in those poses, rad or m; its part has no source.
    """
    model = final.model
    assert isinstance(model, ChainModel)
    tip = model.known.payload[0]
    parts: list[tuple[Contribution | None, Array]] = []
    for given in final.contributions_to(slice(0, model.shared_size)):
        chain = extended_chain(model, final.fit.shared, given.covariance, tip, {})
        parts.append((given, predict_tip(chain, conditions).covariance))
    extended = extended_chain(model, final.fit.shared, final.covariance(), tip, {})
    by_joints = tip_by_joints(extended, conditions)
    own_readings = by_joints @ (reading_sigma[:, None] ** 2 * np.swapaxes(by_joints, -1, -2))
    return extended, [*parts, (None, np.asarray(own_readings))]


def tip_table(final: FittedModel, settings: Campaign) -> pa.Table:
    """Rows of tip_uncertainty.parquet: contribution of each source to each component of the tip's predicted pose."""
    model = final.model
    assert isinstance(model, ChainModel)
    conditions = _some(_in_right_columns(model))
    extended, parts = tip_contributions(final, conditions, _reading_sigma(model, settings, final.learned[0]))
    tip = predict_tip(extended, conditions)
    vector = log_so3(tip.R)
    estimate = np.concatenate([tip.p / _MM, vector], 1)
    to_units = np.zeros((len(vector), 6, 6))
    to_units[:, :3, :3], to_units[:, 3:, 3:] = np.eye(3) / _MM, np.linalg.inv(left_jacobian_so3(vector))
    links = extended.tree.nodes[extended.tip].link, extended.tree.nodes[0].link
    rows: list[TableRow] = []
    for source, covariance in parts:
        turned = to_units @ covariance @ np.swapaxes(to_units, -1, -2)
        sigma = np.sqrt(np.maximum(np.diagonal(turned, axis1=1, axis2=2), 0.0))
        common = {"body": links[0], "parent": links[1]} | (
            _OWN_READINGS if source is None else source_of(final, source)
        )
        if not sigma.any():
            continue
        for b, pose in enumerate(conditions.poses):
            rows += [
                {
                    **common,
                    "pose": str(pose),
                    "quantity": name,
                    "unit": unit,
                    "estimate": float(estimate[b, k]),
                    "contribution": float(sigma[b, k]),
                }
                for k, (name, unit) in enumerate(_COMPONENTS.items())
            ]
    return pa.Table.from_pylist(rows, schema=ARTIFACTS["tip_uncertainty"].arrow_schema("string"))


def _in_right_columns(model: ChainModel) -> ChainConditions:
    """Conditions without errors of this campaign's table; zeros that are far off belong to the extended model."""
    readings = model.conditions.readings
    for cause in model.causes:
        readings = readings if cause.is_persistent else cause.corrected(readings, model.tree.readings)
    return replace(model.conditions, readings=readings)


def _some(conditions: ChainConditions) -> ChainConditions:
    count = len(conditions.readings)
    mask = np.zeros(count, bool)
    mask[np.unique(np.linspace(0, count - 1, min(count, _MOST)).round().astype(int))] = True
    return conditions.subset(mask)


def _reading_sigma(model: ChainModel, settings: Campaign, ratio: float) -> Array:
    """Declared noise (n,) of the readings, rad or m, times the ratio at which the campaign shows it."""
    noise = settings.noise
    declared = np.where(model.tree.is_revolute, noise.joint_deg * _DEG, noise.joint_mm * _MM)
    return declared * ratio
