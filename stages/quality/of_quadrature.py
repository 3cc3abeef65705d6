"""Quality of an interferometer's raw signals: are they round once corrected, and were fringes counted safely?"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from stages.quality.check import FAIL, PASS, Check

if TYPE_CHECKING:
    import pyarrow as pa

ROUND = 0.01  # of the mean radius
_RISK = 1e-3


def quadrature_checks(channels: pa.Table) -> Iterator[Check]:
    """Two checks of every channel."""
    for row in channels.to_pylist():
        yield _round(row)
        yield _counted(row)


def _round(row: dict[str, Any]) -> Check:
    share, uncut = row["radius_after"] / row["radius_mean"], row["radius_uncut"] / row["radius_mean"]
    name = row["channel"]
    said = f"{name}: corrected by its ellipse, the radius of the raw signals scatters by {100.0 * share:.2g} % of it."
    if row["cut_share"] > 0.0:
        said += f" {100.0 * row['cut_share']:.2g} % of the samples stand at an end of the converter's range;"
        said += f" the others scatter by {100.0 * uncut:.2g} % about an ellipse of their own."
    return Check("signals-round", f"channel {name}", share, ROUND, "1", FAIL if share > ROUND else PASS, said)


def _counted(row: dict[str, Any]) -> Check:
    risk, name = row["miscount_risk"], row["channel"]
    said = f"{name}: no step from sample to sample is likelier than {risk:.1g} to have been counted a fringe off."
    return Check("fringes-counted", f"channel {name}", risk, _RISK, "1", FAIL if risk > _RISK else PASS, said)
