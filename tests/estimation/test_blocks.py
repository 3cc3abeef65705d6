"""Blocks of poses: complete, in order, and the same in any number of threads."""

from __future__ import annotations

import threading

import pytest

from truing import threads
from truing.estimation.blocks import pose_blocks
from truing.threads import in_order


@pytest.mark.parametrize(("poses", "targets", "points"), [(0, 5, 10), (1, 5, 10), (7, 5, 10), (100, 3, 7), (10, 0, 10)])
def test_blocks_hold_every_pose_once_and_few_points(poses: int, targets: int, points: int) -> None:
    found = pose_blocks(poses, targets, points)
    assert [row for block in found for row in range(block.start, block.stop)] == list(range(poses))
    assert len(found) >= 1
    assert all((block.stop - block.start) * targets <= max(points, targets) for block in found)


def test_results_keep_their_order_and_few_items_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first item ends last, while later ones are done; never are more than a few ahead of what is used."""
    monkeypatch.setattr(threads, "available_processors", lambda: 3)
    released, begun = threading.Event(), []

    def work(item: int) -> int:
        begun.append(item)
        if item == 0:
            assert released.wait(30.0)
        elif item == 2:
            released.set()
        return item * item

    found = []
    for done, value in enumerate(in_order(work, list(range(40)))):
        assert len(begun) <= done + 1 + 3 + 2
        found.append(value)
    assert found == [item * item for item in range(40)]


def test_an_error_in_a_block_is_raised() -> None:
    def work(item: int) -> int:
        if item == 3:
            raise ValueError("found 3")
        return item

    with pytest.raises(ValueError, match="found 3"):
        list(in_order(work, list(range(9))))
