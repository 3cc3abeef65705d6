"""Errors of predictions in the components of [requirement]: of a chain's tip in the axes of its base."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from truing.arrays import Array, Mask
from truing.estimation.rotation import skew
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.mechanisms.chains.distances import DistanceModel
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.stages.diagnosis.residual_tables import errors_by_role

if TYPE_CHECKING:
    from truing.inference.observations import Observations
    from truing.inference.prediction import PredictionError
    from truing.inference.selection import CauseDiagnosis
    from truing.simulation.effects_model import EffectsModel
    from truing.stages.diagnosis.diagnosis_data import DiagnosisData

COMPONENTS = {"x": "mm", "y": "mm", "z": "mm", "rx": "deg", "ry": "deg", "rz": "deg"}
_SI = np.array([1e-3] * 3 + [np.pi / 180.0] * 3)
# Targets on one line show no rotation about it: least square of their width over that of their length.
_WIDE = 1e-4


@dataclass(frozen=True)
class _Channels:
    """Measured minus predicted (B, K, 3) of positions and orientations, with covariance; places of positions; m, rad.

    All in the axes of the base, (B, K, ...).
    """

    gap: Array
    cov: Array
    is_observed: Mask
    places: Array
    turned: Mask  # (K,) orientations
    node: Array  # (K,) the joint that moves the link

    def of(self, rows: Mask) -> _Channels:
        """Some of the channels (K,)."""
        every = {name: getattr(self, name)[:, rows] for name in ("gap", "cov", "is_observed", "places")}
        return replace(self, **every, turned=self.turned[rows], node=self.node[rows])


def tip_errors(diagnosis: CauseDiagnosis, data: DiagnosisData[EffectsModel]) -> pa.Table | None:
    """Rows of component_errors.parquet by the final model; None if nothing was measured that moves with the tip.

    The position is that of a measured pose, or the mean of the targets seen. In frames of single poses, errors are
    relative to the link that defines them. Two targets, or targets on one line, show no rotation.
    """
    epochs = {"calibration": data.calibration} | ({} if data.held_out is None else {"verification": data.held_out})
    rows: dict[str, list[object]] = {name: [] for name in ("pose", "role", "component", "missed", "sigma", "unit")}
    for role, _, after in errors_by_role(diagnosis):
        motions = _motions(after, epochs[role].measured)
        if motions is None:
            return None
        missed, variance = motions
        poses, known = epochs[role].conditions.poses, np.isfinite(missed)
        for k, (name, unit) in enumerate(COMPONENTS.items()):
            index = np.flatnonzero(known[:, k])
            rows["pose"] += [poses[b] for b in index]
            rows["role"] += [role] * len(index)
            rows["component"] += [name] * len(index)
            rows["missed"] += (missed[index, k] / _SI[k]).tolist()
            rows["sigma"] += (np.sqrt(variance[index, k]) / _SI[k]).tolist()
            rows["unit"] += [unit] * len(index)
    identifier = "int64" if all(isinstance(pose, int) for pose in rows["pose"]) else "string"
    return pa.table(rows, schema=ARTIFACTS["component_errors"].arrow_schema(identifier))


def _motions(error: PredictionError, declared: Observations) -> tuple[Array, Array] | None:
    """Errors (B, 6) of the tip and variances of their measurement, m and rad, base axes; NaN where not measured."""
    model = error.model
    assert isinstance(model, ChainModel)
    if isinstance(model, DistanceModel) and not len(model.coordinates):
        return None
    channels, tip = _channels(error, model, declared), model.tree.moving_node(model.known.payload[0])
    of_tip = np.array(channels.node == tip, bool)
    if not of_tip.any():
        return None
    on_tip = channels.of(of_tip)
    at = _placed(on_tip)
    weight = np.where(at, 1.0, 0.0)[..., None]
    centre = np.sum(on_tip.places * weight, 1) / np.maximum(weight.sum(1), 1.0)
    missed, cov = _motion(on_tip, centre)
    if error.frames.free:
        below, spread = _motion(channels.of(channels.node == channels.node.min()), centre)
        missed = np.where(np.isfinite(below).all(1, keepdims=True), missed - below, np.nan)
        cov = cov + spread
    return missed, np.diagonal(cov, axis1=1, axis2=2)


def _channels(error: PredictionError, model: ChainModel, declared: Observations) -> _Channels:
    """Positions and orientations with their full error, even if the model decoupled or supplemented them."""
    count, channels = len(declared.values), model.channels
    gap, values, cov = error.gap, declared.values, declared.covariance
    is_observed: Mask = np.asarray(error.is_observed)
    to_frame, origin = error.frames.R, error.frames.t
    if isinstance(model, DistanceModel):  # numbers have no frames of single poses
        to_frame, origin = np.eye(3)[None], np.zeros((1, 3))
        size = len(model.coordinates)
        gap, values = (part[:, :size].reshape(count, -1, 3) for part in (gap, values))
        cov = cov[:, :size, 0, 0].reshape(count, -1, 3)[..., None] * np.eye(3)
        is_observed = np.asarray(is_observed[:, :size].reshape(count, -1, 3).all(-1))
    some = slice(0, gap.shape[1])
    conditions = model.own_conditions
    if (coupling := conditions.coupling) is not None:
        part = coupling[:, some][:, :-1]
        gap, cov = gap.copy(), cov.copy()
        gap[:, :-1] += np.einsum("bkij,bkj->bki", part, gap[:, 1:])
        cov[:, :-1] += part @ cov[:, 1:] @ np.swapaxes(part, -1, -2)
    to_base = np.swapaxes(to_frame @ model.known.base_R[conditions.series], -1, -2)[:, None]
    movers = np.array([model.tree.moving_node(int(k)) for k in channels.node[some]])
    places = (to_base @ (values - origin[:, None])[..., None])[..., 0]
    return _Channels(
        (to_base @ gap[..., None])[..., 0],
        to_base @ cov @ np.swapaxes(to_base, -1, -2),
        is_observed,
        places,
        channels.is_rotation[some],
        movers,
    )


def _motion(channels: _Channels, centre: Array) -> tuple[Array, Array]:
    """Shift at ``centre`` (B, 3) and rotation (B, 6) that fit the errors best, with covariance (B, 6, 6); NaN where
    nothing shows them."""
    levers = np.where(channels.turned[:, None], 0.0, channels.places - centre[:, None])
    by = np.zeros((*levers.shape, 6))
    by[..., 3:] = -skew(levers)
    by[..., :3] = np.where(channels.turned[:, None, None], 0.0, np.eye(3))
    by[:, channels.turned, :, 3:] = np.eye(3)
    weights = np.linalg.inv(np.where(channels.is_observed[..., None, None], channels.cov, np.eye(3)))
    weights = weights * channels.is_observed[..., None, None]
    weighted = np.swapaxes(by, -1, -2) @ weights
    normal, right = np.sum(weighted @ by, 1), np.sum(weighted @ channels.gap[..., None], 1)
    placed = _placed(channels).any(1, keepdims=True)
    turns = (
        channels.is_observed[:, channels.turned].any(1, keepdims=True) | _is_wide(levers, _placed(channels))[:, None]
    )
    known = np.concatenate([placed, placed, placed, turns, turns, turns], 1)
    normal = np.where(known[:, :, None] & known[:, None], normal, np.eye(6))
    cov = np.linalg.inv(normal)
    return np.where(known, (cov @ right)[..., 0], np.nan), cov


def _placed(channels: _Channels) -> Mask:
    """Mask (B, K) of the positions seen."""
    return np.asarray(channels.is_observed & ~channels.turned, bool)


def _is_wide(levers: Array, is_observed: Mask) -> Mask:
    """Mask (B,) of the poses whose targets span a plane, so that they show rotations about all axes."""
    weight = np.where(is_observed, 1.0, 0.0)[..., None]
    weighted_levers = levers * weight
    weighted_levers = (
        weighted_levers - weighted_levers.sum(1, keepdims=True) / np.maximum(weight.sum(1, keepdims=True), 1.0)
    ) * weight
    size = np.linalg.eigvalsh(np.einsum("bki,bkj->bij", weighted_levers, weighted_levers))
    return np.asarray(size[:, 1] > _WIDE * size[:, 2])
