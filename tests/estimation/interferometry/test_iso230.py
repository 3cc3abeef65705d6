"""ISO 230-2: relations between its quantities, and coverage of its intervals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tolerance import assert_between, assert_close
from truing.estimation.interferometry.iso230 import (
    InstrumentUncertainty,
    is_in_motion,
    positioning,
    positioning_uncertainty,
)

seeds = st.integers(0, 2**31)


def made(seed: int, positions: int = 5, cycles: int = 5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    systematic = 5e-3 * rng.standard_normal((positions, 1, 1)) + 1e-3 * rng.standard_normal((positions, 2, 1))
    return systematic + rng.uniform(1e-4, 2e-3) * rng.standard_normal((positions, 2, cycles))


@given(seeds)
def test_quantities_bound_one_another(seed: int) -> None:
    own = positioning(made(seed))
    assert own.bidirectional_repeatability >= own.repeatability.max()
    assert own.bidirectional_systematic >= own.systematic.max()
    assert own.bidirectional_accuracy >= own.accuracy.max()
    assert own.mean_deviation <= own.bidirectional_systematic + 1e-18
    assert own.reversal <= own.bidirectional_systematic + 1e-18
    assert abs(own.mean_reversal) <= own.reversal + 1e-18
    assert own.bidirectional_accuracy <= own.bidirectional_systematic + own.repeatability.max() + 1e-18
    assert own.bidirectional_repeatability <= own.repeatability.max() + own.reversal + 1e-18


@given(seeds, st.floats(-1.0, 1.0), st.floats(0.1, 10.0))
def test_shifting_and_scaling_the_deviations(seed: int, shift: float, scale: float) -> None:
    x = made(seed)
    before, after = positioning(x), positioning(scale * (x + shift))
    for name in ("reversal", "mean_reversal", "bidirectional_repeatability", "bidirectional_systematic"):
        assert_close(getattr(after, name), scale * getattr(before, name), atol=1e-12)
    assert_close(after.mean_deviation, scale * before.mean_deviation, atol=1e-12)
    assert_close(after.bidirectional_accuracy, scale * before.bidirectional_accuracy, atol=1e-12)


@given(seeds)
def test_directions_exchanged(seed: int) -> None:
    x = made(seed)
    one, other = positioning(x), positioning(x[:, ::-1])
    assert_close(other.mean_reversal, -one.mean_reversal, atol=1e-15)
    assert_close(other.reversal, one.reversal, atol=1e-15)
    assert_close(other.accuracy, one.accuracy[::-1], atol=1e-15)
    assert_close(other.bidirectional_accuracy, one.bidirectional_accuracy, atol=1e-15)


def test_without_scatter_only_the_systematic_part_is_left() -> None:
    mean = np.array([[1.0, 0.5], [3.0, 2.0], [2.0, 2.5]])
    own = positioning(np.repeat(mean[..., None], 4, axis=-1))
    assert (own.reversal, own.bidirectional_systematic, own.bidirectional_repeatability) == (1.0, 2.5, 1.0)
    assert_close(own.mean_reversal, (0.5 + 1.0 - 0.5) / 3, atol=1e-15)
    assert_close(own.mean_deviation, 2.5 - 0.75, atol=1e-15)
    assert own.bidirectional_accuracy == own.bidirectional_systematic
    assert_close(own.systematic, [2.0, 2.0], atol=0.0)


def test_batches_are_tests_side_by_side() -> None:
    x = np.stack([made(1), made(2)])
    both = positioning(x)
    assert_close(both.bidirectional_accuracy, [positioning(one).bidirectional_accuracy for one in x], atol=1e-15)
    for shape in ((5, 2), (5, 3, 4), (5, 2, 1)):
        with pytest.raises(ValueError, match="2 directions"):
            positioning(np.zeros(shape))


def test_truth_lies_in_the_intervals_and_the_sigmas_are_those_of_repetitions() -> None:
    """An axis of many cycles, from tests of five. R is a maximum of scatters of four degrees of freedom: its value lies
    above the truth and its stated uncertainty too."""
    rng = np.random.default_rng(1)
    mean = 4e-3 * np.sin(np.arange(6))[:, None] + [[5e-4, -5e-4]]
    scatter, tests = 6e-4, 200
    reversal, spread = np.abs(mean[:, 0] - mean[:, 1]), np.ptp(mean)
    true = {
        "B": reversal.max(),
        "R": 4.0 * scatter + reversal.max(),
        "E": spread,
        "M": np.ptp(mean.mean(1)),
        "A": spread + 4.0 * scatter,
    }
    x = mean[..., None] + scatter * rng.standard_normal((tests, 6, 2, 5))
    found = [positioning_uncertainty(one, np.arange(6.0), rng, draws=300) for one in x]
    for symbol, value in true.items():
        values, sigmas, hits = np.array(
            [(one[symbol].value, one[symbol].sigma, one[symbol].low <= value <= one[symbol].high) for one in found]
        ).T
        assert_between(hits.mean(), 0.95 - 4 * np.sqrt(0.95 * 0.05 / tests), 1.0, what=f"coverage of {symbol}")
        widest = 2.0 if symbol == "R" else 1.35
        assert_between(sigmas.mean() / values.std(), 0.85, widest, what=f"sigma of {symbol}")


def test_instruments_share_is_added() -> None:
    """A scale error stretches E of an axis of length L by L, and leaves its repeatability alone."""
    rng = np.random.default_rng(2)
    at = np.linspace(0.0, 1.0, 6)
    x = np.repeat(np.repeat(1e-5 * at[:, None, None], 2, axis=1), 5, axis=2) + 1e-9 * rng.standard_normal((6, 2, 5))
    instrument = InstrumentUncertainty(
        scale=3e-7, expansion=11.5e-6, temperature_sigma=0.05, expansion_sigma=1e-6, warmer_by=0.4
    )
    assert_close(instrument.stretch, np.sqrt(3e-7**2 + 5.75e-7**2 + 4e-7**2), atol=1e-15)
    found = positioning_uncertainty(x, at, rng, instrument)
    assert_between(found["E"].sigma / instrument.stretch, 0.95, 1.05)
    assert found["R"].sigma < 2e-9
    tilted = positioning_uncertainty(x, at, rng, InstrumentUncertainty(misalignment=1e-3))
    assert_between(tilted["E"].high - tilted["E"].value, 1e-7, 3e-6)
    drifting = positioning_uncertainty(x, at, rng, InstrumentUncertainty(drift=1e-6))
    assert drifting["B"].sigma > 1e-7


# Five targets in five cycles, 1e-8 mm, and what the report of that test prints: ecmccfg of the Paul Scherrer Institute,
# examples/test/fat_sat/report.md (2023). Its E is that of the forward direction alone, and its R no maximum of R(i).
FORWARD_READ = """
-8102 -10202 -8702 -9202 -10002
-8702 -9702 -9702 -9502 -8202
-7202 -9002 -8802 -8702 -8702
-10202 -8602 -8602 -9302 -7802
-10002 -11202 -12902 -10902 -9702
"""
BACKWARD_READ = """
-9902 -9402 -8202 -9102 -9402
-10302 -10402 -9502 -11102 -9302
-8602 -10202 -9102 -7602 -9902
-7202 -9202 -9502 -10302 -8102
-10402 -12602 -13002 -14102 -10702
"""
PRINTED = {
    "reversal_at": [-40.0, 960.0, 600.0, -40.0, 1220.0],
    "bidirectional_at": [3517.0, 3772.0, 4170.0, 4871.0, 6882.0],
    "reversal": 1220.0,
    "mean_reversal": 540.0,
    "repeatability": [5033.0, 6290.0],
    "systematic": [2460.0, 3300.0],
    "mean_deviation": 2770.0,
    "accuracy": [6428.0, 8881.0],
    "bidirectional_accuracy": 8881.0,
}


@pytest.mark.parametrize("name", PRINTED)
def test_a_laboratory_prints_the_same_quantities(name: str) -> None:
    read = [np.array(text.split(), float).reshape(5, 5) for text in (FORWARD_READ, BACKWARD_READ)]
    own = positioning(np.stack(read, 1))
    assert_close(getattr(own, name), PRINTED[name], atol=1.0)
    assert own.bidirectional_repeatability == own.bidirectional_at.max()
    assert_close(own.bidirectional_systematic, np.ptp(own.mean), atol=1e-9)


@pytest.mark.parametrize(
    ("dwell_s", "speed", "is_even", "expected"),
    [
        (3.0, 0.05, True, False),
        (3.0, 0.05, False, False),
        (0.0, 0.05, True, True),  # a target every 0.4 s
        (0.0, 0.005, False, True),  # slow, but at one speed over uneven steps
        (0.0, 0.005, True, False),  # could have stopped: data do not tell
    ],
)
def test_motion_is_known_by_times_from_target_to_target(
    dwell_s: float, speed: float, is_even: bool, expected: bool
) -> None:
    rng = np.random.default_rng(4)
    target = np.cumsum(np.full(15, 0.02) if is_even else rng.uniform(0.01, 0.03, 15))
    command = np.concatenate([target, target[::-1]] * 3)
    time = np.cumsum(
        dwell_s + np.abs(np.diff(command, prepend=command[0])) / speed + rng.normal(0.0, 1e-3, len(command))
    )
    assert is_in_motion(command, time) is expected
    assert not is_in_motion(command, np.zeros(len(command))), "no times"
    assert not is_in_motion(command, 1.0 * np.arange(len(command))), "counted rows"
