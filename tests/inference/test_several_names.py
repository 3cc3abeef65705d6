"""Several accepted causes of one subject are doubted if a single unnamed effect explains equally much."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from truing.inference.several_names import cancel, several_for_one


def cause(
    name: str, subject: str, *, catalogued: bool = True, onset: int = 0, is_set: bool = False, part: str = ""
) -> Any:
    """Stand in for a cause."""
    key = f"{name} {subject} {onset}"
    return SimpleNamespace(
        id=name,
        subject=subject,
        affected_part=part or subject,
        key=key,
        catalogued=catalogued,
        has_set_shape=is_set,
    )


def candidate(own: Any) -> Any:
    return SimpleNamespace(cause=own, key=own.key, kind=own.id)


def scored(odds: dict[str, float]) -> Any:
    """Stand in for a round, by the log odds of its candidates."""
    scores = {key: SimpleNamespace(log_posterior=value) for key, value in odds.items()}
    return SimpleNamespace(scores=scores, posterior=lambda one: odds[one.key])


GAIN, GAP = cause("gain", "leg4"), cause("backlash", "leg4")
FRICTION = cause("unexplained", "leg4", catalogued=False)
ELSEWHERE = cause("unexplained", "leg2", catalogued=False)


def always(first: Any, second: Any) -> bool:
    return True


def never(first: Any, second: Any) -> bool:
    return False


def doubted(of_one: float, *, unnamed: Any = FRICTION) -> set[str]:
    """Doubted names of a gain with log odds of 40, then a gap with 5, next to an effect with log odds ``of_one``."""
    first, second = scored({GAIN.key: 40.0, GAP.key: 10.0, unnamed.key: of_one}), scored({GAP.key: 5.0})
    last = SimpleNamespace(candidates=[candidate(unnamed)])
    return several_for_one([(GAIN, candidate(GAIN), first), (GAP, candidate(GAP), second)], last, always)


def test_two_names_are_doubted_where_one_effect_is_as_probable() -> None:
    assert doubted(45.0) == {GAIN.key, GAP.key}
    assert doubted(42.5) == {GAIN.key, GAP.key}, "a factor of 12 against it decides nothing"


def test_two_names_hold_where_they_are_clearly_more_probable() -> None:
    assert doubted(41.0) == set()


def test_an_effect_of_another_subject_is_no_rival() -> None:
    assert doubted(60.0, unnamed=ELSEWHERE) == set()


def test_names_of_two_runs_are_doubted_where_one_effect_of_their_channel_is_as_probable() -> None:
    """A zero that drifts in one run and a slip in another may be one random course of the channel."""
    drift, slip = (cause(name, run, part="channel dx") for name, run in (("drift", "run 2"), ("slip", "run 5")))
    of_channel = cause("unexplained", "channel dx", catalogued=False)
    last = SimpleNamespace(candidates=[candidate(of_channel)])

    def doubted_for(log_odds: float) -> set[str]:
        first = scored({drift.key: 10.0, slip.key: 15.0, of_channel.key: log_odds})
        accepted = [(drift, candidate(drift), first), (slip, candidate(slip), scored({slip.key: 16.0}))]
        return several_for_one(accepted, last, never)

    assert doubted_for(48.0) == {drift.key, slip.key}
    assert doubted_for(20.0) == set()


def test_a_single_name_is_not_concerned() -> None:
    last = SimpleNamespace(candidates=[candidate(FRICTION)])
    first = scored({GAIN.key: 40.0, FRICTION.key: 60.0})
    assert several_for_one([(GAIN, candidate(GAIN), first)], last, always) == set()


def test_two_steps_of_one_zero_are_doubted_and_steps_of_two_are_not() -> None:
    def steps(other: str, alike: Any = always, first: str = "run 4") -> set[str]:
        own = [cause("zero-step", first), cause("zero-step", other, onset=9)]
        now = scored({one.key: 30.0 for one in own})
        return several_for_one([(one, candidate(one), now) for one in own], SimpleNamespace(candidates=[]), alike)

    assert len(steps("run 4")) == 2
    assert len(steps("", first="")) == 2, "two jumps of a base, which is the only one"
    assert steps("run 5") == set()
    assert steps("run 4", never) == set(), "no course of one pattern is behind both"


def test_periods_that_the_machine_sets_are_no_steps_of_a_course() -> None:
    for is_set, names in ((False, {"wave axis 1", "wave axis 2"}), (True, set())):
        first, second = (cause("wave", "axis", onset=order, is_set=is_set) for order in (1, 2))
        rounds = scored({first.key: 40.0, second.key: 30.0}), scored({second.key: 30.0})
        accepted = [(one, candidate(one), own) for one, own in zip((first, second), rounds, strict=True)]
        assert several_for_one(accepted, SimpleNamespace(candidates=[]), always) == names


def test_steps_cancel_only_if_equal_and_opposite() -> None:
    there, sure = np.array([3e-4, -2e-4, 1e-4]), 36e-12 * np.eye(3)
    noise = 6e-6 * np.random.default_rng(1).normal(size=(2, 3))
    assert cancel((there + noise[0], sure), (noise[1] - there, sure))
    assert not cancel((there, sure), (there, sure))
    assert not cancel((there, sure), (-0.8 * there, sure))
    assert not cancel((there, 1e4 * sure), (-there, 1e4 * sure))
    assert not cancel((there, sure), (-there[:2], sure[:2, :2]))
