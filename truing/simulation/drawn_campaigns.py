"""Draw whole campaigns: a machine or sensor within tolerances, its measurements with noise, gross errors and effects.

The measurements come from the nonlinear simulation; nothing is linearised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.rotation import exp_so3
from truing.simulation.bench.causes.reading_causes import ReadingCause
from truing.simulation.bench.model import BenchModel
from truing.simulation.cause import Effect
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.mechanisms.point_causes import PointCause

# Gross errors are some tenths of a millimetre: far above the noise, but comparable with large effects.
_GROSS_M = 5e-4
# Gross errors of readings, as a multiple of the noise.
_GROSS_NOISE = 100.0


@dataclass(frozen=True)
class CampaignLayout:
    """Layout of a campaign: plain model at its poses, covariance of every point, and visible points.

    ``rotations`` (B, 3, 3) turn from the base to the axes of each pose's measurement, in which ``covariance`` (B, K, 3,
    3), m^2, is given; None: drawn at random. ``gross`` is the share of points with gross errors.
    """

    model: MechanismModel
    covariance: NDArray
    is_observed: NDArray  # (B, K)
    rotations: NDArray | None = None
    gross: float = 0.0


@dataclass(frozen=True)
class DrawnPoints:
    """Measurements of a drawn campaign: points (B, K, 3), m, each pose in its own frame, and the survey (K, 3), m."""

    points: NDArray
    survey: NDArray


def draw_campaign(
    layout: CampaignLayout, effects: Sequence[Effect[PointCause]], rng: np.random.Generator
) -> DrawnPoints:
    """Draw a campaign of the layout, with effects hidden in it.

    Raises ValueError if the drawn mechanism cannot reach the readings.
    """
    model = layout.model.with_causes([effect.cause for effect in effects])
    shared, local = _true_unknowns(model, effects, rng)
    state = model.state(shared, local)
    if not state.converged.all():
        raise ValueError("readings that a mechanism within the declared tolerances can reach")
    points = _measured(model.points(shared, local), layout, rng)
    return DrawnPoints(points, _survey(model, shared, rng))


def _true_unknowns(
    model: MechanismModel, effects: Sequence[Effect[PointCause]], rng: np.random.Generator
) -> tuple[NDArray, NDArray]:
    """Draw the true unknowns from their priors; unknowns without prior knowledge stay at nominal values.

    All but the effects is drawn independently of the effects.
    """
    plain = model.with_causes(())
    shared = plain.embedded(rng.standard_normal(plain.shared_size), model)
    for name in ("seat", *model.known.open_geometry):
        shared[model.layout[name]] = 0.0
    model.set_effects(shared, effects)
    local = rng.standard_normal((len(model.conditions.readings), model.local_size))
    local[:, model.unpredicted] = 0.0
    return shared, local


def _measured(points: NDArray, layout: CampaignLayout, rng: np.random.Generator) -> NDArray:
    """Return points in the frames of their measurements, with noise and gross errors."""
    poses, count, _ = points.shape
    drawn = exp_so3(rng.uniform(-1.5, 1.5, (poses, 3)))
    rotations = drawn if layout.rotations is None else layout.rotations
    noise = np.linalg.cholesky(layout.covariance) @ rng.standard_normal((poses, count, 3, 1))
    wrong = rng.random((poses, count)) < layout.gross
    errors = rng.normal(0.0, _GROSS_M, (poses, count, 3)) * wrong[..., None]
    origin = rng.normal(0.0, 0.2, (poses, 1, 3))
    return np.asarray(points @ np.swapaxes(rotations, 1, 2) + origin + noise[..., 0] + errors)


def _survey(model: MechanismModel, shared: NDArray, rng: np.random.Generator) -> NDArray:
    """Return the survey of the drawn machine: targets on attachments at their true positions plus noise."""
    survey, targets = model.known.shape.copy(), model.targets.at_attachment
    if targets.any():
        noise = model.known.survey.attachment_factor @ rng.standard_normal(3 * int(targets.sum()))
        survey[targets] = model.legs(shared).b[model.targets.leg[targets]] + noise.reshape(-1, 3)
    return survey


def draw_readings(
    model: BenchModel, effects: Sequence[Effect[ReadingCause]], rng: np.random.Generator, gross: float = 0.0
) -> NDArray:
    """Draw readings (B, K), SI, of a campaign of the plain model's layout, with effects hidden in it.

    All but the effects is drawn independently of the effects; ``gross`` is the share of readings with gross errors.
    """
    hidden = model.with_causes([effect.cause for effect in effects])
    plain = model.with_causes(())
    local_shape = len(model.conditions.load), model.local_size
    is_known = plain.predict(np.zeros(plain.shared_size), np.zeros(local_shape)).shared_known
    shared = plain.embedded(np.where(is_known, rng.standard_normal(plain.shared_size), 0.0), hidden)
    hidden.set_effects(shared, effects)
    local = rng.standard_normal(local_shape)
    exact = hidden.points(shared, local)[..., 0]
    sigma = model.known.sigma
    noise = sigma * rng.standard_normal(exact.shape)
    wrong = rng.random(exact.shape) < gross
    return np.asarray(exact + noise + wrong * _GROSS_NOISE * sigma * rng.standard_normal(exact.shape))
