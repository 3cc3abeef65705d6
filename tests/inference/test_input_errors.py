"""Errors of inputs: known where observations determine them, and told to follow their own input only if they do."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from truing.inference.campaign_inputs import InTime
from truing.inference.fitted_model import FittedModel
from truing.inference.input_errors import input_errors, own_histories
from truing.inference.input_spectra import Spectra

EPOCHS, LEVEL = 48, 0.05
NAMES = ("rho1_mm", "rho2_mm", "rho3_mm")


def _spectra(rng: np.random.Generator) -> Spectra:
    columns = {name: rng.uniform(-1.0, 1.0, EPOCHS) for name in NAMES}
    return Spectra({"time_s": 60.0 * np.arange(EPOCHS), **columns}, InTime(np.arange(EPOCHS, dtype=float), None))


def _friction(course: np.ndarray) -> np.ndarray:
    """Mean of three elements that move on only beyond their thresholds, less the course."""
    kept, out, thresholds = np.zeros(3), np.empty(len(course)), np.array([0.2, 0.5, 0.8])
    for n, now in enumerate(course - course[0]):
        kept = np.clip(kept, now - thresholds, now + thresholds)
        out[n] = np.mean(kept - now)
    return np.asarray(out / out.std())


def _told(errors: np.ndarray, spectra: Spectra) -> set[str]:
    return {name for name, _, _ in own_histories(errors, NAMES, spectra, LEVEL)}


def test_errors_without_order_follow_nothing() -> None:
    alarms = 0
    for seed in range(10):
        rng = np.random.default_rng([seed, 1])
        alarms += bool(_told(rng.standard_t(3.0, (EPOCHS, 3)), _spectra(rng)))
    assert alarms <= 2


def test_friction_of_two_inputs_is_told_of_these_two() -> None:
    right = 0
    for seed in range(6):
        rng = np.random.default_rng([seed, 2])
        spectra = _spectra(rng)
        errors = rng.standard_normal((EPOCHS, 3))
        for place in (0, 2):
            errors[:, place] += 2.0 * _friction(spectra.columns[NAMES[place]])
        right += _told(errors, spectra) == {NAMES[0], NAMES[2]}
    assert right >= 5


def test_an_error_that_follows_another_input_is_not_its_own() -> None:
    rng = np.random.default_rng(3)
    spectra = _spectra(rng)
    errors = rng.standard_normal((EPOCHS, 3))
    errors[:, 0] += 4.0 * np.cos(3.0 * spectra.columns[NAMES[1]])
    assert not _told(errors, spectra)


def _fitted(rows: int, rng: np.random.Generator) -> tuple[FittedModel, np.ndarray]:
    """A fit of three inputs next to two further unknowns, off the optimum, and the true errors of the inputs."""
    by_local = rng.standard_normal((EPOCHS, rows, 5))
    truth, fitted = rng.standard_normal((2, EPOCHS, 5))
    residual = (by_local @ (truth - fitted)[..., None])[..., 0]
    problem = SimpleNamespace(by_local=by_local, residual=residual, local_value=fitted)
    own = SimpleNamespace(
        fit=SimpleNamespace(whitened=SimpleNamespace(problem=problem)),
        input_rows=slice(2, 5),
        scene=SimpleNamespace(inputs=dict.fromkeys(NAMES)),
    )
    return cast(FittedModel, own), truth[:, 2:]


def test_errors_of_inputs_are_those_without_any_prior() -> None:
    fitted, truth = _fitted(7, np.random.default_rng(4))
    found = input_errors(fitted)
    assert found is not None
    np.testing.assert_allclose(found, truth, atol=1e-9)


@pytest.mark.parametrize("rows", [2, 4])
def test_errors_that_observations_do_not_determine_are_not_asked(rows: int) -> None:
    assert input_errors(_fitted(rows, np.random.default_rng(5))[0]) is None
