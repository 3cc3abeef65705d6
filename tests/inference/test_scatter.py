"""Inputs that scatter more than declared are found, with the right size."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from tests.tolerance import assert_between
from truing.inference.model import ScatterCandidate
from truing.inference.scatter import (
    FoundScatter,
    InputResiduals,
    likeliest_scatter,
    overlapping_candidates,
    scattering,
    unbiased,
)

EPOCHS, INPUTS, NOISE = 40, 6, 3.0
LEVEL = 0.01


def _candidates() -> list[ScatterCandidate]:
    spans = [(first, first + length) for length in (4, 8, 13) for first in range(0, EPOCHS - length + 1, 2)]
    rows = [np.arange(EPOCHS)[:, None] * np.ones(INPUTS) for _ in spans]
    found = [(row >= first) & (row < last) for row, (first, last) in zip(rows, spans, strict=True)]
    found += [np.ones((EPOCHS, INPUTS), bool) & (np.arange(INPUTS) == own) for own in range(INPUTS)]
    return [ScatterCandidate(SimpleNamespace(), own, True) for own in found]  # type: ignore[type-var]


def _fit(rng: np.random.Generator, scatter: NDArray) -> InputResiduals:
    """Fitted inputs that scatter by the given prior sigmas (B, H), next to correlated noise."""
    mixing = rng.normal(size=(INPUTS, INPUTS)) / 2 + np.eye(INPUTS)
    noise = NOISE**2 * mixing @ mixing.T
    gain = np.linalg.inv(np.eye(INPUTS) + noise)
    seen = scatter * rng.normal(size=scatter.shape) + rng.multivariate_normal(np.zeros(INPUTS), noise, len(scatter))
    return InputResiduals(seen @ gain.T, np.broadcast_to(gain, (len(scatter), INPUTS, INPUTS)))


def test_inputs_that_scatter_as_they_should_are_seldom_said_to_do_more() -> None:
    rng, candidates = np.random.default_rng(1), _candidates()
    said = [scattering(_fit(rng, np.ones((EPOCHS, INPUTS))), candidates, 0.2) for _ in range(60)]
    assert_between(sum(found is not None for found in said), 2, 22, what="of 60 at a level of 20 %")


def test_the_group_that_scatters_and_its_size_are_found() -> None:
    rng, candidates = np.random.default_rng(2), _candidates()
    true = candidates[30]
    pulls = []
    for _ in range(40):
        residuals = _fit(rng, np.where(true.own, 30.0, 1.0))
        found = scattering(residuals, candidates, LEVEL)
        assert found is not None
        assert found[0] in overlapping_candidates(candidates, true)
        factor, share = residuals.factor(true.own)
        pulls.append((factor / 30.0 - 1.0) / max(share, 1.0 / np.sqrt(2.0 * true.own.sum())))
    assert_between(float(np.mean(pulls)), -3.0 / np.sqrt(40), 3.0 / np.sqrt(40), what="mean pull of the factor")


def test_the_scatter_of_an_input_is_found_next_to_others_that_move_the_observations_alike() -> None:
    """Two inputs move the observations nearly alike, and the one that scatters is known a hundred times better."""
    rng, epochs, strength = np.random.default_rng(5), 60, 1.6
    candidates = [ScatterCandidate(SimpleNamespace(), np.arange(INPUTS) == own, True) for own in range(INPUTS)]  # type: ignore[type-var]
    candidates = [
        ScatterCandidate(candidate.cause, np.tile(candidate.own, (epochs, 1)), True) for candidate in candidates
    ]
    moves = np.eye(INPUTS)
    moves[:, 4] = moves[:, 3] + 0.5 * moves[:, 5]
    moves *= np.where(np.arange(INPUTS) == 4, 1e-3, 1e-1)  # per prior sigma, in units of the noise
    redundancy = moves.T @ np.linalg.solve(np.eye(INPUTS) + moves @ moves.T, moves)
    found = []
    for _ in range(20):
        scatter = np.where(np.arange(INPUTS) == 4, strength / np.sqrt(redundancy[4, 4]), 1.0)
        seen = (scatter * rng.normal(size=(epochs, INPUTS))) @ moves.T + rng.normal(size=(epochs, INPUTS))
        rest = seen @ np.linalg.solve(np.eye(INPUTS) + moves @ moves.T, moves)
        residuals = InputResiduals(rest, np.broadcast_to(redundancy, (epochs, INPUTS, INPUTS)))
        found.append(scattering(residuals, candidates, LEVEL))
    right = [one is not None and one[0] is candidates[4] for one in found]
    assert_between(sum(right), 19, 20, what="of 20")


def test_the_likeliest_scatter_allows_for_the_uncertainty_of_each_input() -> None:
    rng, candidates = np.random.default_rng(3), _candidates()
    residuals = _fit(rng, np.ones((EPOCHS, INPUTS)))
    true = candidates[12]
    assert likeliest_scatter(residuals, candidates, np.where(true.own, 30.0, 1.0)) is true


def _estimated(rng: np.random.Generator, own: NDArray, size: float) -> tuple[float, float]:
    """A scatter beyond the prior sigma and its sigma, from a fit whose priors are as wide as inputs really scatter."""
    mixing = rng.normal(size=(INPUTS, INPUTS)) / 2 + np.eye(INPUTS)
    noise, wide = NOISE**2 * mixing @ mixing.T, np.where(own, np.sqrt(1.0 + size**2), 1.0)
    seen = wide * rng.normal(size=own.shape) + rng.multivariate_normal(np.zeros(INPUTS), noise, EPOCHS)
    reported = np.linalg.inv(wide[..., None] ** 2 * np.eye(INPUTS) + noise)
    residuals = InputResiduals(
        wide * np.einsum("bij,bj->bi", reported, seen), wide[:, :, None] * reported * wide[:, None]
    )
    factor, share = residuals.factor(own)
    square = (1.0 + size**2) * factor**2
    found = max(square - 1.0, 0.0) ** 0.5
    return unbiased(found, square / max(found, square**0.5 / 2) * share)


def test_scatter_is_estimated_without_bias_and_with_its_sigma() -> None:
    """Of four epochs (few values, whose root is low), of one input in all of them, of a third of the epochs."""
    rng, epochs = np.random.default_rng(4), np.arange(EPOCHS)[:, None] * np.ones(INPUTS)
    cases = (epochs < 4, 1500, 6.0), ((epochs >= 0) & (np.arange(INPUTS) == 2), 400, 20.0), (epochs < 13, 400, 6.0)
    for own, trials, size in cases:
        found = np.array([_estimated(rng, own, size) for _ in range(trials)])
        known = float(np.std(found[:, 0]) / size / np.sqrt(trials))
        assert_between(float(np.mean(found[:, 0]) / size), 1 - 3 * known, 1 + 3 * known, what="mean over truth")
        inside = np.abs(found[:, 0] - size) < 1.96 * found[:, 1]
        assert_between(float(inside.mean()), 0.93 - 2 / np.sqrt(trials) / 4, 0.98, what="share of 95 % intervals")


def test_a_scatter_of_nothing_does_not_remain() -> None:
    sizes = [(0.0, 3900.0, False), (1e-4, 9e-5, False), (1e-4, 2e-5, True)]
    for size, sigma, remains in sizes:
        assert FoundScatter(_candidates()[0], 1e-4, size, sigma).remains is remains
