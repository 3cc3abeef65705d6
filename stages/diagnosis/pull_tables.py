"""The geometry's pulls before and after the model was extended, and what they come to together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.inference.pulls import Pulls, pulls
from truing.simulation.mechanisms.extended_model import IdentifiedGeometry, identified_geometry
from truing.simulation.mechanisms.model import PointModel
from truing.stages.common.rows import Rows

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.fitted_model import FittedModel


@dataclass(frozen=True)
class Fitted:
    """A model with the shared unknowns (G,) that were fitted and their covariance (G, G), in prior sigmas."""

    model: PointModel
    shared: NDArray
    covariance: NDArray


def fitted_mechanism(stand: FittedModel) -> Fitted:
    """The fit of a mechanism's model."""
    assert isinstance(stand.model, PointModel)
    return Fitted(stand.model, stand.fit.shared, stand.covariance())


@dataclass(frozen=True)
class Belief:
    """How far unknowns (n,) moved from where they were believed to be, and their covariance (n, n), in prior sigmas."""

    shift: NDArray
    covariance: NDArray


def pull_tables(before: Fitted, after: Fitted) -> dict[str, pa.Table]:
    """Return pulls.parquet and pull_sums.parquet; without rows where no tolerance says where the geometry belongs.

    Shifts are counted from nominal, also where the campaign starts from an earlier one: what that knew is data.
    """
    geometries = [identified_geometry(one.model, one.shared, one.covariance) for one in (before, after)]
    kept = zip(geometries[1].parameters, geometries[1].known, strict=True)
    names: list[tuple[int | None, str]] = [(entry.leg + 1, entry.name) for entry, known in kept if known]
    return _tables(names, *(_pulls(geometry) for geometry in geometries))


def sensor_pull_tables(names: list[tuple[int | None, str]], before: Belief, after: Belief) -> dict[str, pa.Table]:
    """Return the same of a sensor, whose unknowns are named by leg (None: all legs) and what they are."""
    return _tables(names, *(pulls(one.shift, np.eye(len(names)), one.covariance) for one in (before, after)))


def _tables(names: list[tuple[int | None, str]], before: Pulls, after: Pulls) -> dict[str, pa.Table]:
    rows, sums = Rows("pulls"), Rows("pull_sums")
    if names:
        rows.add(
            leg=[leg for leg, _ in names],
            parameter=[name for _, name in names],
            pull_before=before.pull,
            pull_after=after.pull,
            identifiable=after.identifiable,
        )
        for model, one in (("plain", before), ("extended", after)):
            band = {"lower": one.lower, "upper": one.upper, "p_value": one.p_value}
            sums.add(model=model, chi_square=one.chi_square, freedom=one.freedom, **band)
    return {"pulls": rows.table(), "pull_sums": sums.table()}


def _pulls(geometry: IdentifiedGeometry) -> Pulls:
    own = np.flatnonzero(geometry.known)
    shift = (geometry.values - geometry.nominal)[own]
    return pulls(shift, geometry.prior[np.ix_(own, own)], geometry.covariance[np.ix_(own, own)])
