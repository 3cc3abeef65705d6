"""Timing of benchmarks: the number of calls of each task, and seconds per call."""

from __future__ import annotations

from collections import Counter

import pytest

from benchmarks.timing import interleaved
from tests.tolerance import assert_close


@pytest.mark.parametrize(("repeats", "long", "short"), [(1, 1, 1 + 11), (3, 1 + 3, 2 + 3 * 11)])
def test_a_long_task_is_called_once_in_a_repeat_and_a_short_one_fills_twenty_milliseconds(
    repeats: int, long: int, short: int
) -> None:
    took, now, calls = {"long": 0.5, "short": 0.0019}, [0.0], Counter[str]()

    def task(name: str) -> None:
        calls[name] += 1
        now[0] += took[name]

    found = interleaved({name: lambda name=name: task(name) for name in took}, repeats, lambda: now[0])
    assert calls == {"long": long, "short": short}
    for name, seconds in found.items():
        assert_close(seconds, [took[name]] * repeats, atol=1e-9, what=name)
