"""Do the readings, poses, points and the description of a mechanism belong together?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from stages.quality.bodies import BodyView, Surroundings
from truing.belonging.relation import Tested

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign


def relations_of_points(
    bodies: Sequence[BodyView], around: Surroundings, tables: Mapping[str, pa.Table], settings: Campaign
) -> tuple[Tested, ...]:
    """Return the tested relations of a campaign of object points."""
    return ()
