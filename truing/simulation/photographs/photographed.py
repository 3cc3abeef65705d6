"""Points that were computed from photographs: what their errors have in common."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Photographed:
    """That points come from photographs: with so many ``errors`` common to all poses (of cameras, of scale bars) and so
    many that the points of each pose share (its scale, ..), each of one standard deviation; and the bars that gave them
    their scale, and at which height in the model's frame, m."""

    errors: int = 0
    pose_errors: int = 0
    scale_bars: tuple[str, ...] = ()
    scale_height_m: float = 0.0
