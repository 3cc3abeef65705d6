"""Poses in blocks of limited memory."""

from __future__ import annotations

# Points of a block: few enough for the processor's cache, and enough that calls cost more than their overhead.
POINTS_AT_ONCE = 40_000


def pose_blocks(poses: int, targets: int, points: int = POINTS_AT_ONCE) -> list[slice]:
    """Return the blocks of ``poses`` with ``targets`` targets each, at least one block, of about ``points`` points."""
    step = max(1, points // max(targets, 1))
    return [slice(first, min(first + step, poses)) for first in range(0, max(poses, 1), step)]
