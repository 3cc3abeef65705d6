"""Effects to hide: every kind that a layout could show, with the requested size."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import sample_model
from truing.simulation.bench.causes.beams import CosineError
from truing.simulation.catalogue import catalogue
from truing.simulation.detection_trials import EffectKind, effect_kinds, reported_size, subject_class
from truing.simulation.mechanisms.point_causes import PointScene

LEGS = 6


@pytest.fixture(scope="module")
def scene() -> PointScene:
    return sample_model(np.random.default_rng(2), 24).scene


@pytest.fixture(scope="module")
def found(scene: PointScene) -> list[EffectKind]:
    return effect_kinds([kind for kind in catalogue().values() if kind.catalogued], scene, LEGS)


def test_a_cause_per_leg_is_a_sort_on_the_whole_and_one_on_a_single_leg(found: list[EffectKind]) -> None:
    own = {sort.concerns: len(sort.causes) for sort in found if sort.kind == "actuator-gain"}
    assert own == {"the whole": 1, "one leg": LEGS}


@pytest.mark.parametrize("size", [0.1, 3.0])
def test_an_effect_has_the_size_that_was_asked_for(found: list[EffectKind], size: float) -> None:
    rng = np.random.default_rng(3)
    for sort in found:
        effect = sort.draw(size, LEGS, rng)
        scale = np.array([parameter.scale for parameter in effect.cause.parameters(LEGS)])
        assert np.sqrt(np.mean((effect.values / scale) ** 2)) == pytest.approx(size)
        assert subject_class(effect.cause.subject) == sort.concerns


@pytest.mark.parametrize(
    ("kind", "parameter", "unit", "value"),
    [
        ("actuator-gain", "gain", "1", 0.01),
        ("platform-deformation-matrix", "K", "1", 0.01),
        ("flexure-shift", "flexure_length", "mm", 10.0),
    ],
)
def test_sentences_and_tables_have_the_same_size(
    found: list[EffectKind], kind: str, parameter: str, unit: str, value: float
) -> None:
    cause = next(sort.causes[0] for sort in found if sort.kind == kind and sort.concerns == "the whole")
    once, thrice = reported_size(cause, 1.0, LEGS), reported_size(cause, 3.0, LEGS)
    assert (once.parameter, once.unit) == (parameter, unit)
    assert once.value == pytest.approx(value, rel=1e-9)
    assert thrice.value == pytest.approx(3.0 * value, rel=1e-9)


def test_an_angle_that_grows_with_the_root_of_what_it_loses_is_a_size_too() -> None:
    cause = CosineError("dz", along=True)
    once, twice = (reported_size(cause, size, LEGS) for size in (1.0, 2.0))
    assert (once.parameter, once.unit) == ("angle", "rad")
    assert twice.value == pytest.approx(np.sqrt(2.0) * once.value, rel=1e-3)


def test_a_single_leg_is_reported_with_its_number_and_a_phase_is_no_size(found: list[EffectKind]) -> None:
    waves = [sort for sort in found if sort.kind == "actuator-periodic-error" and sort.concerns == "one leg"]
    for sort in waves:
        assert reported_size(sort.causes[0], 1.0, LEGS).parameter.startswith("amplitude_")


@pytest.mark.parametrize(
    ("subject", "concerns"),
    [("", "the whole"), ("leg3", "one leg"), ("target P07", "one target"), ("leg1 leg4", None), ("targets A B", None)],
)
def test_a_subject_names_the_leg_body_or_target_it_concerns(subject: str, concerns: str | None) -> None:
    assert subject_class(subject) == concerns
