"""Inputs that scatter more than they are known beforehand are found where they are, and as large as they are."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from tests.tolerance import assert_between
from truing.inference.model import ScatterCandidate
from truing.inference.scatter import InputResiduals, likeliest, nearby, scattering

EPOCHS, INPUTS, NOISE = 40, 6, 3.0
LEVEL = 0.01


def _candidates() -> list[ScatterCandidate]:
    spans = [(first, first + length) for length in (4, 8, 13) for first in range(0, EPOCHS - length + 1, 2)]
    rows = [np.arange(EPOCHS)[:, None] * np.ones(INPUTS) for _ in spans]
    found = [(row >= first) & (row < last) for row, (first, last) in zip(rows, spans, strict=True)]
    found += [np.ones((EPOCHS, INPUTS), bool) & (np.arange(INPUTS) == own) for own in range(INPUTS)]
    return [ScatterCandidate(SimpleNamespace(), own, True) for own in found]  # type: ignore[type-var]


def _fit(rng: np.random.Generator, scatter: NDArray) -> InputResiduals:
    """What a fit makes of inputs that scatter by so many prior sigmas (B, H), beside noise that is correlated."""
    mixing = rng.normal(size=(INPUTS, INPUTS)) / 2 + np.eye(INPUTS)
    noise = NOISE**2 * mixing @ mixing.T
    gain = np.linalg.inv(np.eye(INPUTS) + noise)
    seen = scatter * rng.normal(size=scatter.shape) + rng.multivariate_normal(np.zeros(INPUTS), noise, len(scatter))
    return InputResiduals(seen @ gain.T, np.broadcast_to(gain, (len(scatter), INPUTS, INPUTS)))


def test_inputs_that_scatter_as_they_should_are_seldom_said_to_do_more() -> None:
    rng, candidates = np.random.default_rng(1), _candidates()
    said = [scattering(_fit(rng, np.ones((EPOCHS, INPUTS))), candidates, 0.2) for _ in range(200)]
    assert_between(sum(found is not None for found in said), 2, 60, what="of 200 at a level of 20 %")


def test_the_group_that_scatters_and_its_size_are_found() -> None:
    rng, candidates = np.random.default_rng(2), _candidates()
    true = candidates[30]
    pulls = []
    for _ in range(40):
        residuals = _fit(rng, np.where(true.own, 30.0, 1.0))
        found = scattering(residuals, candidates, LEVEL)
        assert found is not None
        assert found[0] in nearby(candidates, true)
        factor, share = residuals.factor(true.own)
        pulls.append((factor / 30.0 - 1.0) / max(share, 1.0 / np.sqrt(2.0 * true.own.sum())))
    assert_between(float(np.mean(pulls)), -3.0 / np.sqrt(40), 3.0 / np.sqrt(40), what="mean pull of the factor")


def test_what_is_known_as_badly_as_it_scatters_is_told_by_the_factor_alone() -> None:
    rng, candidates = np.random.default_rng(3), _candidates()
    residuals = _fit(rng, np.ones((EPOCHS, INPUTS)))
    true = candidates[12]
    assert likeliest(residuals, candidates, np.where(true.own, 30.0, 1.0)) is true
