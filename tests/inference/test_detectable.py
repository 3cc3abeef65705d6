"""The power that linear theory predicts agrees with an F test of simulated residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import f

from tests.tolerance import assert_between
from truing.inference import detectable
from truing.inference.detectable import AcceptanceRule, EffectSensitivity, _Seen, assessed, per_scale
from truing.inference.evidence import log_evidence
from truing.inference.verdicts import FOUND, NOT_TESTABLE, REJECTED, Reason, Verdict

DRAWS = 40_000


@dataclass(frozen=True)
class _Named:
    subject: str = ""
    has_known_scale: bool = False

    @property
    def id(self) -> str:
        """Its kind."""
        return self.subject


@pytest.mark.parametrize("rank", [1, 6, 36])
@pytest.mark.parametrize("ratio", [0.0, 3.0, 6.0, 9.0])
def test_power_is_that_of_the_test_on_simulated_residuals(rank: int, ratio: float) -> None:
    rng, left, threshold = np.random.default_rng(rank), 200, 1e-3
    along = rng.standard_normal((DRAWS, rank))
    along[:, 0] += ratio
    noise = rng.chisquare(left, DRAWS) / left
    found = float(np.mean(f.sf(np.sum(along**2, 1) / rank / noise, rank, left) <= threshold))
    promised = float(AcceptanceRule(rank, left + rank, threshold).power(np.array(ratio)))
    sigma = np.sqrt(max(promised * (1 - promised), threshold) / DRAWS)
    assert_between(found, promised - 4 * sigma, promised + 4 * sigma, what="power")


@pytest.mark.parametrize("rank", [1, 6])
@pytest.mark.parametrize("threshold", [0.02, 1e-4])
def test_power_counts_what_is_clearly_more_probable_than_no_effect(rank: int, threshold: float) -> None:
    """Where few causes are searched, a found effect needs its probability rather than its p-value."""
    rng, freedom, prior, strength, size = np.random.default_rng(rank), 300.0, 1 / 20, 40.0, 0.13 / np.sqrt(rank)
    strengths, loadings = np.full(rank, strength), np.eye(rank)
    by_test = AcceptanceRule(rank, freedom, threshold)
    cause = _Named()
    seen = _Seen(EffectSensitivity(cause, "any", by_test, per_scale(strengths, loadings)), strengths, loadings, prior)
    expected = seen.sensitivity_of_found().power(size)

    pattern = rng.standard_normal((DRAWS, rank))
    pattern *= np.sqrt(rank) / np.linalg.norm(pattern, axis=1, keepdims=True)
    along = size * strength * pattern + rng.standard_normal((DRAWS, rank))
    squares, left = np.sum(along**2, 1), rng.chisquare(freedom - rank, DRAWS)
    is_significant = f.sf(squares / rank / (left / (freedom - rank)), rank, freedom - rank) <= threshold
    odds = log_evidence(along, strengths, left + squares, freedom) + np.log(prior)
    found = float(np.mean(is_significant & (odds >= np.log(9.0))))
    assert_between(found, expected - 0.03, expected + 0.03, what="power")
    if threshold == 0.02:
        assert by_test.power(np.array([size * strength * np.sqrt(rank)]))[0] > found + 0.1


def test_a_shape_drawn_at_random_is_found_less_often_than_the_median_one() -> None:
    """Onsets near the end of a campaign are seen by a few poses alone, or by none."""
    of_shapes = np.concatenate([np.full(30, 6.0), np.full(15, 2.0), np.zeros(5)])
    sight = EffectSensitivity(_Named(), "any", AcceptanceRule(1, 300.0, 1e-4), np.array([6.0]), of_shapes)
    rule = sight.rule.power(np.array([6.0, 2.0, 0.0]))
    assert sight.rate(1.0) == pytest.approx((30 * rule[0] + 15 * rule[1] + 5 * rule[2]) / 50)
    assert sight.rate(1.0) < sight.power(1.0) - 0.2
    alone = EffectSensitivity(_Named(), "any", sight.rule, np.array([6.0]))
    assert alone.rate(1.0) == alone.power(1.0)


def test_a_pattern_in_no_particular_direction_is_seen_by_its_strengths() -> None:
    rng = np.random.default_rng(1)
    loadings, _ = np.linalg.qr(rng.standard_normal((6, 6)))
    found = per_scale(np.full(6, 2.0), loadings)
    assert np.allclose(found, 2.0 * np.sqrt(6))  # root mean square one, so the length is the root of six
    assert per_scale(np.array([3.0]), np.array([[1.0]])) == pytest.approx([3.0])


def test_the_smallest_size_has_the_power_that_was_asked_for_and_grows_with_it() -> None:
    rng = np.random.default_rng(2)
    sight = EffectSensitivity(_Named(), "any", AcceptanceRule(4, 300.0, 1e-5), rng.uniform(1.0, 6.0, 64))
    sizes = [sight.smallest(power) for power in (0.5, 0.8, 0.95)]
    assert sizes == sorted(sizes)
    for size, power in zip(sizes, (0.5, 0.8, 0.95), strict=True):
        assert sight.power(size) == pytest.approx(power, abs=1e-6)


def test_the_detectable_signal_is_the_sum_of_the_quantiles_of_threshold_and_power() -> None:
    """Normal noise that is all but known: the quantile of the threshold plus that of the power."""
    from scipy.stats import norm

    sight = EffectSensitivity(_Named(), "any", AcceptanceRule(1, 1e7, 1e-5), np.array([1.0]))
    assert sight.smallest(0.8) == pytest.approx(norm.isf(0.5e-5) + norm.ppf(0.8), rel=1e-3)


@pytest.mark.parametrize("sight", [EffectSensitivity(_Named(), "any", AcceptanceRule(0, 1.0, 0.03), np.array([0.0]))])
def test_an_effect_without_signal_has_no_detectable_size(sight: EffectSensitivity) -> None:
    assert sight.smallest() is None
    assert not sight.is_plausible


@pytest.mark.parametrize(("per_plausible_scale", "seen"), [(6.0, True), (0.6, True), (0.06, False)])
def test_an_effect_detectable_only_beyond_plausible_sizes_is_not_testable(
    per_plausible_scale: float, seen: bool
) -> None:
    """Found with four fifths at about five standard deviations: at 0.9, 9 and 90 plausible scales."""
    sight = EffectSensitivity(_Named(), "any", AcceptanceRule(1, 1e7, 1e-5), np.array([per_plausible_scale]))
    assert sight.is_plausible is seen


def test_an_effect_visible_in_half_of_its_directions_has_no_size_of_80_percent_power() -> None:
    half = np.concatenate([np.zeros(32), np.full(32, 5.0)])
    assert EffectSensitivity(_Named(), "any", AcceptanceRule(2, 100.0, 1e-4), half).smallest(0.8) is None


def _verdict(subject: str, verdict: str = REJECTED, reason: Reason | None = Reason.CHANCE) -> Verdict[_Named]:
    unknown = dict.fromkeys(("scale_holds", "before", "after", "floor", "values", "covariance"))
    return Verdict(  # type: ignore[arg-type]  # numbers of what is not looked at
        _Named(subject), verdict, 0.5, 0.1, 0.0, 1.0, held_out=(None, None), candidates=3, reason=reason, **unknown
    )


def test_only_what_chance_alone_decided_against_becomes_not_testable(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cause that predicts worse was seen; what is part of another, too; and what has no size of its own stays."""
    strengths = {"seen": 6.0, "hidden": 0.06, "worse": 0.06, "found": 0.06}
    sights = [
        EffectSensitivity(_Named(name), name, AcceptanceRule(1, 1e7, 1e-5), np.array([own]))
        for name, own in strengths.items()
    ]
    sights.append(
        EffectSensitivity(_Named("one leg"), "seen", AcceptanceRule(1, 1e7, 1e-5), np.array([0.06]))
    )  # the other sort shows it
    monkeypatch.setattr(detectable, "effect_sensitivities", lambda search, level: sights)
    given = [
        _verdict("found", FOUND, None),
        _verdict("seen"),
        _verdict("hidden"),
        _verdict("worse", reason=Reason.HELD_OUT),
        _verdict("sizeless"),
        _verdict("unseen", reason=Reason.UNSEEN),
    ]
    reported = {verdict.cause.subject: verdict.verdict for verdict in assessed(given, None, 0.01)}  # type: ignore[arg-type]
    assert [name for name, verdict in reported.items() if verdict == NOT_TESTABLE] == ["hidden", "unseen"]
    assert reported["found"] == FOUND
    assert list(reported)[-2:] == ["hidden", "unseen"]  # ranked behind what was rejected
