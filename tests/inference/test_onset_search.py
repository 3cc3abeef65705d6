"""Onsets between those that a search tries: the best one, and the interval that data leave open."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.inference import toy_campaign as toy
from truing.inference.model import Onsets
from truing.inference.noise import components
from truing.inference.onset_search import at_best_onsets, onset_interval
from truing.inference.scores import scores_of
from truing.inference.search import CauseCandidate, Search
from truing.inference.signatures import signature

SPACING, FEWEST = 4, 3
POSSIBLE = np.arange(FEWEST, toy.POSES - FEWEST + 1)
SEARCHES = 60


def _jump(onset: int) -> Any:
    return SimpleNamespace(
        key=f"jump at {onset}", onset=onset, catalogued=True, has_known_scale=False,
        like_sized=lambda parts: (), one_sided=lambda parts: (), excludes=lambda other: False,
    )  # fmt: skip


def _design(onset: int) -> dict[str, NDArray]:
    late = (np.arange(toy.POSES) >= onset).astype(float)
    return {"drive": late[:, None, None] * np.eye(toy.DRIVES)[:, [0]]}


def _searched(onset: int, seed: int, size: float = 9.0) -> tuple[Any, Search[Any]]:
    """A fitted model of data with a jump, ``size`` times the noise, and a search that tries every few onsets."""
    clean = toy.channels(toy.measured(np.random.default_rng(0)))
    columns = toy.TEMPLATE.by_local[..., toy.READINGS] @ _design(onset)["drive"]
    effect = columns[..., 0] * size / signature(clean, _design(onset)).strengths[0]
    whitened = toy.measured(np.random.default_rng(seed), effect)
    pathways, noise = toy.channels(whitened), components(whitened, 3 * toy.POINTS, toy.READINGS)
    scene = SimpleNamespace(onsets=lambda cause: Onsets(POSSIBLE, SPACING, cause.onset, _jump))
    fitted: Any = SimpleNamespace(
        noise=noise, model=SimpleNamespace(part_count=0), causes=(), scene=scene,
        partial_designs=lambda cause: _design(cause.onset),
    )  # fmt: skip
    tried = [CauseCandidate(_jump(k), "jump", signature(pathways, _design(k)), 1.0) for k in POSSIBLE[::SPACING]]
    return fitted, Search(pathways, noise, tried, [], {"jump": 1.0}, 9, np.random.default_rng(3))


@pytest.mark.parametrize(("size", "off", "widest"), [(4.0, 2, 0.5), (9.0, 1, 0.15)])
def test_the_best_onset_lies_near_the_true_one_and_the_interval_holds_it(size: float, off: int, widest: float) -> None:
    rng = np.random.default_rng(11)
    held, widths, missed = 0, [], []
    for seed in range(SEARCHES):
        onset = int(rng.choice(POSSIBLE))
        fitted, search = _searched(onset, seed, size)
        scores = scores_of(search.candidates, fitted, search.pathways.residual)
        best = max(zip(scores, search.candidates, strict=True), key=lambda pair: pair[0].squares)[1]
        (best, *_) = (*at_best_onsets(search, scores, fitted), best)
        missed.append(abs(best.cause.onset - onset))
        first, last = onset_interval(best, fitted, search) or (best.cause, best.cause)
        held += first.onset <= onset <= last.onset
        widths.append(last.onset - first.onset)
    # Of 60 intervals of 95 %, fewer than 52 hold the truth once in 500 times. Whole poses make them wider than needed.
    assert held >= 52
    assert np.median(missed) <= off
    assert 1 <= np.mean(widths) <= widest * toy.POSES


def test_a_cause_without_a_free_onset_has_no_interval() -> None:
    fitted, search = _searched(int(POSSIBLE[2]), 0)
    jump = CauseCandidate(_jump(5), "jump", signature(search.pathways, _design(5)), 1.0)
    assert onset_interval(jump, fitted, search) is not None
    fitted.scene.onsets = lambda cause: None
    assert onset_interval(jump, fitted, search) is None
