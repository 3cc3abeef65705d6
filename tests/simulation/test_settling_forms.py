"""Exponential settling is a form of unnamed effects, so that it is not attributed to temperature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from truing.simulation.inputs import TIME
from truing.simulation.nonparametric import SETTLINGS, NonparametricEffect, dependence

SECONDS = np.linspace(300.0, 2800.0, 200)


@dataclass(frozen=True)
class Effect(NonparametricEffect):
    """An effect of nothing in particular."""


def _basis(form: str) -> NDArray:
    effect = Effect(**dependence((TIME,), lambda _: (1550.0, 1250.0), form))
    return effect.basis(lambda _: SECONDS)[:, 0]


@pytest.mark.parametrize("share", [0.13, 0.2, 0.3, 0.42, 0.6, 0.85])
def test_a_warm_up_of_any_time_constant_is_a_form_of_time(share: float) -> None:
    """A warm-up with any time constant is a form of time: hardly anything of its squares is left."""
    warm = 1.0 - np.exp(-(SECONDS - SECONDS[0]) / (share * 2500.0))
    left = [1.0 - np.corrcoef(warm, _basis(form))[0, 1] ** 2 for form in SETTLINGS]
    assert min(left) < 5e-3


def test_settlings_are_together_as_probable_as_proportionality() -> None:
    of_form = {
        form: Effect(**dependence((TIME,), lambda _: (0.0, 1.0), form)).prior(None)  # type: ignore[arg-type]
        for form in ("polynomial", *SETTLINGS)
    }
    assert np.isclose(sum(of_form[form] for form in SETTLINGS), of_form["polynomial"])


def test_time_constants_of_settling_stay_within_their_range() -> None:
    for form in SETTLINGS:
        basis = _basis(form)
        np.testing.assert_allclose(basis[[0, -1]], [-1.0, 1.0], atol=1e-12)
        assert (np.diff(basis) > 0.0).all()
