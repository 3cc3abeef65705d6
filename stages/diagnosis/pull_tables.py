"""The geometry's pulls before and after the model was extended, and what they come to together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.responses.tables import Rows
from truing.estimation.diagnosis.pulls import Pulls, pulls
from truing.simulation.identified import IdentifiedGeometry, identified_geometry

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.simulation.unknowns import Unknowns


@dataclass(frozen=True)
class Fitted:
    """A model with the shared unknowns (G,) that were fitted and their covariance (G, G), in prior sigmas."""

    model: Unknowns
    shared: NDArray
    covariance: NDArray


def pull_tables(before: Fitted, after: Fitted) -> dict[str, pa.Table]:
    """Return pulls.parquet and pull_sums.parquet; without rows where no tolerance says where the geometry belongs.

    Shifts are counted from nominal, also where the campaign starts from an earlier one: what that knew is data.
    """
    geometries = [identified_geometry(one.model, one.shared, one.covariance) for one in (before, after)]
    found = [_pulls(geometry) for geometry in geometries]
    rows, sums, known = Rows("pulls"), Rows("pull_sums"), geometries[1].known
    if known.any():
        entries = [entry for entry, kept in zip(geometries[1].parameters, known, strict=True) if kept]
        rows.add(
            leg=[entry.leg + 1 for entry in entries],
            parameter=[entry.name for entry in entries],
            pull_before=found[0].pull,
            pull_after=found[1].pull,
            identifiable=found[1].identifiable,
        )
        for model, one in zip(("plain", "extended"), found, strict=True):
            band = {"lower": one.lower, "upper": one.upper, "p_value": one.p_value}
            sums.add(model=model, chi_square=one.chi_square, freedom=one.freedom, **band)
    return {"pulls": rows.table(), "pull_sums": sums.table()}


def _pulls(geometry: IdentifiedGeometry) -> Pulls:
    own = np.flatnonzero(geometry.known)
    shift = (geometry.values - geometry.nominal)[own]
    return pulls(shift, geometry.prior[np.ix_(own, own)], geometry.covariance[np.ix_(own, own)])
