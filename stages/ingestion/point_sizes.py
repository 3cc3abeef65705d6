"""Units that cannot be: bodies a thousand times larger in one table than in another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from truing.schemas.faults import Fault

Array = NDArray[np.float64]

_SAME_BODY = 3.0
_OTHER_PLACES = 20.0


@dataclass(frozen=True)
class Geometry:
    """What other tables say of the bodies: surveyed targets by body, and joints by body, in mm.

    ``survey_file`` is the file that the survey stands in.
    """

    survey: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)
    joints: Mapping[str, Array] = field(default_factory=dict)
    survey_file: str = "targets.csv"


def size_faults(
    file: str, points: Mapping[tuple[int, str], Mapping[str, Array]], geometry: Geometry
) -> Iterator[Fault]:
    """A body is as large in the points as in the survey, and about as large as the mechanism's joints are apart.

    The same targets may differ by a factor of 3 before it is a fault (gross errors, deformation), targets and joints
    by 20, because they sit in different places; the wrong unit is off by 25.4 at least.
    """
    for body in dict.fromkeys(body for _, body in points):
        surveyed = geometry.survey.get(body, {})
        ratios = [_ratio(seen, surveyed) for (_, name), seen in points.items() if name == body]
        ratio = float(np.median([value for value in ratios if value > 0.0] or [1.0]))
        if not 1.0 / _SAME_BODY < ratio < _SAME_BODY:
            yield _fault(file, body, ratio, f"in {geometry.survey_file}")
    for body, joints in geometry.joints.items():
        named = geometry.survey.get(body)
        own = geometry.survey_file if named else file
        seen = named or next((targets for (_, name), targets in points.items() if name == body), {})
        ratio = _size(np.array(list(seen.values()))) / _size(joints) if len(seen) > 1 and _size(joints) else 1.0
        if not 1.0 / _OTHER_PLACES < ratio < _OTHER_PLACES and ratio > 0.0:
            yield _fault(own, body, ratio, "by [mechanism] legs of campaign.toml")


def _fault(file: str, body: str, ratio: float, where: str) -> Fault:
    size = f"{ratio:.3g} times that size"
    return Fault(file, f"body {body} to be as large as {where}; is the unit right?", column="x_mm", value=size)


def _ratio(seen: Mapping[str, Array], surveyed: Mapping[str, Array]) -> float:
    """How many times larger a body is than in the survey, by the targets in both; 0 where that cannot be said."""
    common = [target for target in seen if target in surveyed]
    if len(common) < 2:
        return 0.0
    size = _size(np.array([surveyed[target] for target in common]))
    return _size(np.array([seen[target] for target in common])) / size if size else 0.0


def _size(points: Array) -> float:
    """The median distance between two of at most some points (N, 3): gross errors in a few do not matter."""
    if len(points) < 2:
        return 0.0
    some = points[np.linspace(0, len(points) - 1, min(len(points), 40)).astype(int)]
    apart = np.linalg.norm(some[:, None] - some[None], axis=-1)
    return float(np.median(apart[np.triu_indices(len(some), 1)]))
