"""Whether a survey knows the targets that rays name: where it knows none, the adjusted points are those of no body."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truing.schemas.faults import Fault
from truing.schemas.near_names import meant_by

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pyarrow as pa

_SHOWN = 3


def unknown_to_survey(rays: pa.Table, survey: pa.Table, bars: pa.Table | None) -> Iterator[Fault]:
    """A fault where every ray has a name, and the survey knows none of them but ends of scale bars.

    Rays without a name are named by the survey's geometry later on.
    """
    names = set(zip(*(rays.column(name).to_pylist() for name in ("point", "body", "target")), strict=True))
    if any(not target for _, _, target in names):
        return
    ends = set() if bars is None else {*bars.column("first").to_pylist(), *bars.column("second").to_pylist()}
    own = sorted((body, target) for point, body, target in names if point not in ends)
    known = set(zip(survey.column("body").to_pylist(), survey.column("target").to_pylist(), strict=True))
    targets = {target for _, target in known}
    if own and not any((body, target) in known or (not body and target in targets) for body, target in own):
        shown = ", ".join(f"{body}/{target}" if body else target for body, target in own[:_SHOWN])
        expected = f"rays to targets that the survey has ({', '.join(sorted(targets)[:_SHOWN])}, ...)"
        expected += meant_by((name for _, name in own), targets)
        yield Fault("image_points", expected, column="target", value=f"{shown}, ...")
