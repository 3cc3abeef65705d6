"""The test of neighbouring places keeps its level for independent noise, and detects common motion of neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from truing.inference.linear_problem import Whitened, whiten
from truing.inference.linearised_model import LinearisedModel
from truing.inference.spatial_correlation import SpatialCorrelation, has_neighbours, spatial_correlation

EPOCHS, PLACES = 30, 32
BODIES = np.repeat([0, 1], [24, 8])


def _places(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1, 1, (PLACES, 3)) * [1.0, 1.0, 0.2]


def _fit(errors: np.ndarray, places: np.ndarray) -> Whitened:
    """A fit of each body's rigid motion per epoch, and of the places of all targets, to errors (B, K, 3)."""
    epochs = len(errors)
    rigid = np.zeros((PLACES, 3, 12))
    for body in (0, 1):
        own = body == BODIES
        rigid[own, :, 6 * body : 6 * body + 3] = np.eye(3)
        rigid[own, :, 6 * body + 3 : 6 * body + 6] = np.stack([np.cross(axis, places[own]) for axis in np.eye(3)], -1)
    by_local = np.broadcast_to(100.0 * rigid.reshape(-1, 12), (epochs, PLACES * 3, 12))
    by_shared = np.broadcast_to(np.eye(PLACES * 3), (epochs, PLACES * 3, PLACES * 3))
    return whiten(
        LinearisedModel(
            errors.reshape(epochs, -1),
            by_local,
            by_shared,
            np.zeros((epochs, 12)),
            np.zeros(PLACES * 3),
            np.zeros(0),
            np.zeros((0, PLACES * 3)),
            np.ones((epochs, PLACES * 3), bool),
            np.zeros(12, bool),
            np.ones(PLACES * 3, bool),
        )
    )


def _tested(errors: np.ndarray, places: np.ndarray, seed: int = 0) -> SpatialCorrelation:
    found = spatial_correlation(_fit(errors, places), errors.shape, places, BODIES, np.random.default_rng(seed))
    assert found is not None
    return found


def _noise(kind: str, rng: np.random.Generator) -> np.ndarray:
    shape = (EPOCHS, PLACES, 3)
    if kind == "heavy tails":
        return rng.standard_t(4, shape)
    if kind == "noisier places":
        return rng.normal(size=shape) * rng.choice([1.0, 4.0], PLACES, p=[0.8, 0.2])[:, None]
    return rng.normal(size=shape)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["normal", "heavy tails", "noisier places"])
def test_independent_noise_is_rejected_as_often_as_the_level_says(kind: str) -> None:
    rng = np.random.default_rng(1)
    found = np.array([_tested(_noise(kind, rng), _places(rng)).p_value for _ in range(150)])
    assert 0.013 <= np.mean(found < 0.05) <= 0.11
    assert 0.35 <= np.mean(found < 0.5) <= 0.65
    assert found.min() > 1e-4


def test_a_bending_body_is_seen_although_its_bend_follows_nothing() -> None:
    """Bends in several directions, by other amounts in every epoch, of a signal-to-noise ratio of 20."""
    rng = np.random.default_rng(2)
    for _ in range(5):
        places = _places(rng)
        bend, noise = _bends(places, rng), rng.normal(size=(EPOCHS, PLACES, 3))
        bend *= 20.0 / np.linalg.norm(_fit(bend, places).rest)
        assert np.sum(_fit(noise + bend, places).rest ** 2) < 1.2**2 * np.sum(_fit(noise, places).rest ** 2)
        assert _tested(noise, places).p_value > 1e-3
        assert _tested(noise + bend, places).p_value < 1e-4


def _bends(places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Waves (B, K, 3) over the places of the first body, half a wavelength across, by random amounts per epoch."""
    along = places @ rng.normal(size=(3, 4))
    waves = np.sin(2.0 * along / np.std(along, 0) + rng.uniform(0.0, 6.0, 4))
    waves = np.where(BODIES[:, None] == 0, waves, 0.0)
    return np.einsum("kw,bwi->bki", waves, rng.normal(size=(EPOCHS, 4, 3)))


def test_a_rigid_motion_and_wrong_places_are_taken_up_by_the_fit() -> None:
    rng = np.random.default_rng(3)
    places, noise = _places(rng), rng.normal(size=(EPOCHS, PLACES, 3))
    moved = np.where(BODIES[:, None] == 0, rng.normal(0.0, 5.0, (EPOCHS, 1, 3)), 0.0)
    survey = rng.normal(0.0, 0.5, (PLACES, 3))
    plain, changed = _tested(noise, places), _tested(noise + moved + survey, places)
    assert abs(changed.correlation - plain.correlation) < 0.01
    assert changed.p_value > 0.01


def test_numbers_and_single_targets_have_no_neighbours() -> None:
    rng = np.random.default_rng(4)
    places = _places(rng)
    whitened = _fit(rng.normal(size=(EPOCHS, PLACES, 3)), places)
    single = np.arange(PLACES)
    assert not has_neighbours(single)
    assert has_neighbours(BODIES)
    assert spatial_correlation(whitened, (EPOCHS, PLACES, 3), places, single, rng) is None
    assert spatial_correlation(whitened, (EPOCHS, 3 * PLACES, 1), places, BODIES, rng) is None


def test_a_common_motion_in_few_epochs_is_seen_in_these() -> None:
    rng = np.random.default_rng(12)
    places = _places(rng)
    errors = _noise("normal", rng)
    few = np.arange(4)
    errors[few] += 2.0 * np.sin(3.0 * places[:, :1]) * rng.normal(size=(4, 1, 1))
    fit = _fit(errors, places)
    drawn = [
        spatial_correlation(fit, errors.shape, places, BODIES, rng, selected)
        for selected in (few, np.arange(4, EPOCHS))
    ]
    assert drawn[0] is not None
    assert drawn[1] is not None
    assert drawn[0].p_value < 1e-3
    assert drawn[1].p_value > 0.01
