"""What a prior campaign of the same sensor has found, as knowledge that a model of the next one starts from.

Its model.toml tells the compliance, not the lengths and stiffnesses behind it; so what is handed on is the information
about those combinations of them that move the compliance, with the persistent effects. Of both, what was known before
(the tolerances, a plausible size) is taken out, for the next campaign brings it along.
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
# Combinations that move the compliance by less than this share of what the strongest does are told by rounding alone.
_LEAST = 1e-6
_ROUNDS = 6


@dataclass(frozen=True)
class SensorPrior(CampaignPrior[ReadingCause]):
    """What a prior campaign found of a sensor: what it told of the compliance is held against the compliance itself,
    which follows stiffnesses in a curve.

    Its numbers are counted in the sigmas (m,) ``counted`` of lengths and stiffnesses as that campaign had them. along
    (r, m): the combinations that move the compliance; back (r, 36): how they follow it, counted from ``compliance``
    (36,), where they are ``start`` (r,).
    """

    counted: NDArray
    along: NDArray
    back: NDArray
    compliance: NDArray
    start: NDArray

    def values(self, model: PartitionedModel, shared: NDArray) -> NDArray:
        """Return the numbers (n,): unknowns, of which the told combinations are those that the compliance tells."""
        sensor, geometry, stiffness = _parted(model, shared)
        own = np.concatenate([geometry, stiffness]) * self._ratio(sensor)
        reported = self.start + self.back @ (sensor.at(geometry, stiffness).compliance.ravel() - self.compliance)
        others = super().values(model, shared)[len(own) :]
        return np.concatenate([own + self.along.T @ (reported - self.along @ own), others])

    def slopes(self, model: PartitionedModel, shared: NDArray) -> NDArray:
        """Return how the numbers follow their own unknowns (n, n)."""
        sensor, _, stiffness = _parted(model, shared)
        own = np.diag(self._ratio(sensor))
        reported = self.back @ _by_unknowns(sensor, stiffness)
        own = own + self.along.T @ (reported - self.along @ own)
        return block_diagonal(own, super().slopes(model, shared)[len(own) :, len(own) :])

    def _ratio(self, sensor: UncertainSensor) -> NDArray:
        """Return what one sigma of each length and stiffness (m,) is by now: legs may have more in common, or less."""
        return np.asarray(sensor.scales / self.counted)


def sensor_prior(found: ExtendedSensor, model: BenchModel) -> SensorPrior:
    """Return what a prior model tells of the unknowns of a model of the next campaign.

    Tolerances are taken to be those of the next one. Effects that it cannot predict, for want
    of a column, are left out.
    """
    causes = persistent_causes(found.causes, model.part_count, model.steps.covariates, model.known.channels)
    sensor = replace(model.known.sensor, share=found.share)
    start, rows = _behind(sensor, found.compliance)
    left, size, right = np.linalg.svd(rows, full_matrices=False)
    seen = size > _LEAST * size.max(initial=0.0)
    along = right[seen]  # (r, n): combinations of the unknowns, each known to one sigma beforehand
    back = (left[:, seen] / size[seen]).T / _scale(found.compliance)
    sigmas = [model.effect_sigma(cause) for cause in causes]
    places = found.places(causes)
    turn = block_diagonal(back, *(np.diag(1.0 / sigma) for sigma in sigmas))
    precision = np.linalg.inv(turn @ found.covariance[np.ix_(places, places)] @ turn.T)
    spread = block_diagonal(along, np.eye(len(precision) - len(along)))
    information = clipped(spread.T @ clipped(precision - np.eye(len(precision))) @ spread)
    values = [effect.values / model.effect_sigma(effect.cause) for effect in found.effects if effect.cause in causes]
    mean, identity = np.concatenate([along.T @ (along @ start), *values]), np.eye(len(information))
    behind = {"along": along, "back": back, "compliance": found.compliance.ravel(), "start": along @ start}
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
    """Return in what the entries (36,) of a compliance are counted: alike for m and rad, N and N m."""
    size = np.sqrt(np.abs(np.diag(compliance)))
    size = np.where(size > 0.0, size, 1.0)
    return np.outer(size, size).ravel()


def _behind(sensor: UncertainSensor, compliance: NDArray) -> tuple[NDArray, NDArray]:
    """Return the smallest unknowns (n,) that a compliance follows from, and how its counted entries follow them."""
    scale, unknowns = _scale(compliance), np.zeros(sensor.geometry_size + sensor.stiffness_size)
    rows = np.zeros((_ENTRIES, len(unknowns)))
    for _ in range(_ROUNDS):
        geometry, stiffness = np.split(unknowns, [sensor.geometry_size])
        rows = _by_unknowns(sensor, stiffness) / scale[:, None]
        gap = (compliance - sensor.at(geometry, stiffness).compliance).ravel() / scale
        unknowns = np.linalg.lstsq(rows, gap + rows @ unknowns, rcond=_LEAST)[0]
    return unknowns, rows


def _by_unknowns(sensor: UncertainSensor, stiffness: NDArray) -> NDArray:
    """Return how the compliance (36, n) follows lengths and stiffnesses."""
    slopes = np.concatenate([sensor.by_geometry.compliance, sensor.by_stiffness(stiffness).compliance])
    return np.asarray(slopes.reshape(-1, _ENTRIES).T)


def _parted(model: PartitionedModel, shared: NDArray) -> tuple[UncertainSensor, NDArray, NDArray]:
    """Return the sensor of a model of readings, with its lengths and its stiffnesses at shared unknowns (G,)."""
    known: KnownReadings = model.known  # type: ignore[attr-defined]
    return known.sensor, shared[model.layout["geometry"]], shared[model.layout["stiffness"]]


def _parts(
    sensor: UncertainSensor, causes: tuple[ReadingCause, ...], effects: list[NDArray]
) -> tuple[SharedUnknowns, ...]:
    geometry, stiffness = np.split(sensor.scales, [sensor.geometry_size])
    own = [SharedUnknowns("geometry", geometry), SharedUnknowns("stiffness", stiffness)]
    return (*own, *(SharedUnknowns(cause.key, sigma) for cause, sigma in zip(causes, effects, strict=True)))
