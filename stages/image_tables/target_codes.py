"""Whether the codes that a campaign declares exist in their families."""

from __future__ import annotations

from functools import cache

import numpy as np

from schemas.photographs import FAMILIES, RINGS
from truing.formats.faultlog import FaultLog
from truing.formats.gather import Gathered


def check_codes(found: Gathered, boards: tuple[str, ...], log: FaultLog) -> None:
    """A fault at every family that no photograph is searched for, and at every code that its family does not have."""
    families = [family or "" for family in found.table.column("family").to_pylist()]
    codes = [code or "" for code in found.table.column("code").to_pylist()]
    named = ("circle", *FAMILIES, *boards)
    unknown = np.array([family not in named for family in families], dtype=bool)
    found.fault(log, unknown, "family", f"one of {', '.join(FAMILIES)}, or the name of a board")
    for family in sorted(set(families) & set(FAMILIES)):
        own = np.array([one == family for one in families], dtype=bool)
        absent = np.array([code not in _codes(family) for code in codes], dtype=bool)
        found.fault(log, own & absent, "code", f"one of the {len(_codes(family))} codes of {family}")


@cache
def _codes(family: str) -> frozenset[str]:
    if family in RINGS:
        from truing.estimation.image_targets.ring_codes import family_of_rings

        return frozenset(map(str, family_of_rings(family).numbers))
    from truing.estimation.image_targets.marker_codes import codes_of

    return frozenset(map(str, range(codes_of(family))))
