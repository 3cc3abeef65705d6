"""Results of a prior campaign of the same sensor as prior knowledge for the next one.

model.toml holds the compliance, not the lengths and stiffnesses behind it. Therefore the prior is information on those
combinations of them that change the compliance, and on the persistent effects. Prior knowledge of both (tolerances,
plausible sizes) is removed, because the next campaign has it too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.simulation.bench.causes.reading_causes import ReadingCause
from truing.simulation.bench.extended_model import ExtendedSensor
from truing.simulation.bench.known_readings import KnownReadings
from truing.simulation.bench.model import BenchModel
from truing.simulation.bench.six_upur.uncertain_sensor import UncertainSensor
from truing.simulation.prior_campaign import (
    CampaignPrior,
    PartitionedModel,
    SharedUnknowns,
    block_diagonal,
    clipped,
    persistent_causes,
)

_ENTRIES = 36
# Combinations that change the compliance by less than this share of the strongest are rounding.
_LEAST = 1e-6
_ROUNDS = 6


@dataclass(frozen=True)
class SensorPrior(CampaignPrior[ReadingCause]):
    """Results of a prior campaign of a sensor, compared with the compliance itself, which is nonlinear in stiffnesses.

    Its numbers are in sigmas (m,) ``counted`` of that campaign's lengths and stiffnesses. along (r, m): combinations
    that change the compliance; back (r, 36): their derivative by it, relative to ``compliance`` (36,), where they are
    ``start`` (r,).
    """

    counted: NDArray
    along: NDArray
    back: NDArray
    compliance: NDArray
    start: NDArray

    def values(self, model: PartitionedModel, shared: NDArray) -> NDArray:
        """Return the numbers (n,): unknowns, whose identified combinations are computed from the compliance."""
        sensor, geometry, stiffness = _sensor_and_stiffness(model, shared)
        shifts = np.concatenate([geometry, stiffness]) * self._ratio(sensor)
        reported = self.start + self.back @ (sensor.at(geometry, stiffness).compliance.ravel() - self.compliance)
        other_values = super().values(model, shared)[len(shifts) :]
        return np.concatenate([shifts + self.along.T @ (reported - self.along @ shifts), other_values])

    def slopes(self, model: PartitionedModel, shared: NDArray) -> NDArray:
        """Return the derivative (n, n) of the numbers by their unknowns."""
        sensor, _, stiffness = _sensor_and_stiffness(model, shared)
        ratios = np.diag(self._ratio(sensor))
        reported = self.back @ _derivative_by_unknowns(sensor, stiffness)
        ratios = ratios + self.along.T @ (reported - self.along @ ratios)
        return block_diagonal(ratios, super().slopes(model, shared)[len(ratios) :, len(ratios) :])

    def _ratio(self, sensor: UncertainSensor) -> NDArray:
        """Return the present sigma of each length and stiffness (m,) over the former: the common share of legs may
        differ."""
        return np.asarray(sensor.scales / self.counted)


def sensor_prior(extended: ExtendedSensor, model: BenchModel) -> SensorPrior:
    """Return the prior that an identified sensor gives for the model of the next campaign.

    Its tolerances are assumed to be those of the next campaign. Effects that this cannot predict, because a column is
    missing, are omitted.
    """
    causes = persistent_causes(extended.causes, model.part_count, model.steps.covariates, model.known.channels)
    sensor = replace(model.known.sensor, share=extended.share)
    start, rows = _smallest_unknowns(sensor, extended.compliance)
    left, size, right = np.linalg.svd(rows, full_matrices=False)
    is_observed = size > _LEAST * size.max(initial=0.0)
    along = right[is_observed]  # (r, n): combinations of the unknowns, each with a prior sigma of one
    back = (left[:, is_observed] / size[is_observed]).T / _scale(extended.compliance)
    sigmas = [model.effect_sigma(cause) for cause in causes]
    indices = extended.places(causes)
    turn = block_diagonal(back, *(np.diag(1.0 / sigma) for sigma in sigmas))
    precision = np.linalg.inv(turn @ extended.covariance[np.ix_(indices, indices)] @ turn.T)
    spread = block_diagonal(along, np.eye(len(precision) - len(along)))
    information = clipped(spread.T @ clipped(precision - np.eye(len(precision))) @ spread)
    values = [effect.values / model.effect_sigma(effect.cause) for effect in extended.effects if effect.cause in causes]
    mean, identity = np.concatenate([along.T @ (along @ start), *values]), np.eye(len(information))
    behind = {"along": along, "back": back, "compliance": extended.compliance.ravel(), "start": along @ start}
    return SensorPrior.of(
        causes,
        _parts(sensor, causes, sigmas),
        (mean, np.linalg.inv(identity + information)),
        information,
        identity,
        counted=sensor.scales,
        **behind,
    )


def _scale(compliance: NDArray) -> NDArray:
    """Return the scale of the entries (36,) of a compliance, which makes m and rad, N and N m comparable."""
    size = np.sqrt(np.abs(np.diag(compliance)))
    size = np.where(size > 0.0, size, 1.0)
    return np.outer(size, size).ravel()


def _smallest_unknowns(sensor: UncertainSensor, compliance: NDArray) -> tuple[NDArray, NDArray]:
    """Return the smallest unknowns (n,) that give a compliance, and the derivatives of its scaled entries by them."""
    scale, unknowns = _scale(compliance), np.zeros(sensor.geometry_size + sensor.stiffness_size)
    rows = np.zeros((_ENTRIES, len(unknowns)))
    for _ in range(_ROUNDS):
        geometry, stiffness = np.split(unknowns, [sensor.geometry_size])
        rows = _derivative_by_unknowns(sensor, stiffness) / scale[:, None]
        gap = (compliance - sensor.at(geometry, stiffness).compliance).ravel() / scale
        unknowns = np.linalg.lstsq(rows, gap + rows @ unknowns, rcond=_LEAST)[0]
    return unknowns, rows


def _derivative_by_unknowns(sensor: UncertainSensor, stiffness: NDArray) -> NDArray:
    """Return the derivatives (36, n) of the compliance by lengths and stiffnesses."""
    slopes = np.concatenate([sensor.by_geometry.compliance, sensor.by_stiffness(stiffness).compliance])
    return np.asarray(slopes.reshape(-1, _ENTRIES).T)


def _sensor_and_stiffness(model: PartitionedModel, shared: NDArray) -> tuple[UncertainSensor, NDArray, NDArray]:
    """Return the sensor of a model of readings, with its lengths and its stiffnesses at shared unknowns (G,)."""
    known: KnownReadings = model.known  # type: ignore[attr-defined]
    return known.sensor, shared[model.layout["geometry"]], shared[model.layout["stiffness"]]


def _parts(
    sensor: UncertainSensor, causes: tuple[ReadingCause, ...], effects: list[NDArray]
) -> tuple[SharedUnknowns, ...]:
    geometry, stiffness = np.split(sensor.scales, [sensor.geometry_size])
    unknowns = [SharedUnknowns("geometry", geometry), SharedUnknowns("stiffness", stiffness)]
    return (*unknowns, *(SharedUnknowns(cause.key, sigma) for cause, sigma in zip(causes, effects, strict=True)))
