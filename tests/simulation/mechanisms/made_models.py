"""Extended models with every cause of the catalogue and random unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.simulation.mechanisms.telescope import MATRIX, readings, sample_model
from truing.simulation.catalogue import catalogue
from truing.simulation.inputs import APPROACH, LAST_STEP, ORDER, RATE
from truing.simulation.mechanisms.causes.nonparametric import NonparametricMechanismEffect
from truing.simulation.mechanisms.causes.targets import TargetsSwapped
from truing.simulation.mechanisms.extended_model import ExtendedModel, extended
from truing.simulation.mechanisms.model import MechanismModel
from truing.simulation.mechanisms.point_causes import PointCause, PointScene
from truing.simulation.mechanisms.recording import Conditions
from truing.simulation.mechanisms.weight import Weight
from truing.simulation.targets import LEG

POSES = 12
EFFECTS = (MATRIX, NonparametricMechanismEffect(columns=(APPROACH,), centres=(0.0,), half_ranges=(1.0,), degree=1))


def some_conditions(rng: np.random.Generator, poses: int = POSES) -> Conditions:
    covariates = {
        "time_s": np.linspace(0.0, 3600.0, poses),
        "temperature_c": 20.0 + rng.uniform(-2.0, 2.0, poses),
        "humidity": rng.uniform(30.0, 60.0, poses),
        ORDER: np.arange(float(poses)),
        APPROACH: rng.choice([-1.0, 1.0], (poses, 6)),
        LAST_STEP: rng.uniform(-1e-3, 1e-3, (poses, 6)),
        RATE: rng.uniform(-1e-4, 1e-4, (poses, 6)),
    }
    return Conditions(readings(rng, poses), covariates, tuple(range(1, poses + 1)), (0.0, 3600.0))


def named_model(rng: np.random.Generator, causes: tuple[PointCause, ...]) -> MechanismModel:
    model = sample_model(rng, POSES, causes)
    kinds = [("base", "platform")[body] if body < LEG else f"leg{leg + 1}" for body, leg in _places(model)]
    named = replace(model.targets, names=tuple(f"P{k:02d}" for k in range(len(kinds))), bodies=tuple(kinds))
    weighed = replace(model.known, weight=Weight((0.0, 0.0, 1.0), 12.0, (0.0, 0.01, 0.05)))
    return replace(model, targets=named, known=weighed).at(some_conditions(rng))


def _places(model: MechanismModel) -> list[tuple[int, int]]:
    return list(zip(model.targets.body.tolist(), model.targets.leg.tolist(), strict=True))


def made_model(rng: np.random.Generator, causes: tuple[PointCause, ...] = EFFECTS) -> ExtendedModel:
    model = named_model(rng, causes)
    shared = rng.normal(size=model.shared_size) * 0.1
    factor = rng.normal(size=(model.shared_size, model.shared_size)) / model.shared_size
    return extended(model, shared, factor @ factor.T, {"campaign": 'a "quoted" name'})


def _some(cause: PointCause, scene: PointScene) -> list[PointCause]:
    """The first and the last of what a cause offers, also as it is fitted in the end."""
    offered = list(cause.candidates(scene))
    for family in cause.channel_candidates(scene):
        shape, target = np.argwhere(family.usable)[-1]
        offered.append(family.member(int(family.channels[target]), int(shape)))
    chosen = offered[:1] + offered[-1:]
    return list({one.key: one for found in chosen for one in (found, found.refined())}.values())


def _offered() -> list[PointCause]:
    scene = named_model(np.random.default_rng(0), ()).scene
    found = [one for cause in catalogue().values() for one in _some(cause, scene)]
    return [*found, TargetsSwapped("base", ("P00", "P01"), (3, 4), (2.0, 3.0))]


OFFERED = _offered()
