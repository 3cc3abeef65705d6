"""Do the loads, readings and signals of a loading campaign belong together?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from truing.belonging.relation import Tested

if TYPE_CHECKING:
    import pyarrow as pa

    from schemas.campaign import Campaign
    from stages.quality.loading_view import LoadingView


def relations_of_loads(view: LoadingView, tables: Mapping[str, pa.Table], settings: Campaign) -> tuple[Tested, ...]:
    """Return the tested relations of a loading campaign."""
    return ()
