"""Checks of points on an open chain: a link needs no frame of its own, since the joints relate its targets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import pyarrow as pa

from truing.stages.quality import point_checks
from truing.stages.quality.belonging import READINGS
from truing.stages.quality.check import Check, CheckResults

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign

_OF_FRAMES = ("poses-determined", "geometry", "geometry-line", "geometry-plane", "geometry-leverage")
_FEWEST = 3


def checks(tables: Mapping[str, pa.Table], settings: Campaign) -> CheckResults:
    """Every check of object points, but for those of a frame of links with fewer than three targets."""
    found = point_checks.checks(tables, settings)
    if found.why_not:
        return found
    relations = tuple(one for one in found.relations if one.relation != READINGS)
    return replace(found, checks=_without_frames(found, _single(tables["observations"])), relations=relations)


def _single(observations: pa.Table) -> set[str]:
    """Links with fewer than three targets."""
    pairs = set(zip(*(observations.column(name).to_pylist() for name in ("body", "target")), strict=True))
    links = [link for link, _ in pairs]
    return {link for link in links if links.count(link) < _FEWEST}


def _without_frames(found: CheckResults, single: set[str]) -> Iterator[Check]:
    for check in found.checks:
        of_frame = check.check in _OF_FRAMES and (check.subject in single or check.subject.startswith("target "))
        if check.check != READINGS and not (of_frame and single):
            yield check
