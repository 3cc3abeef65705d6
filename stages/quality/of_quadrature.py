"""Quality of an interferometer's raw signals: are they round once corrected, and were fringes counted safely?"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from truing.report.numbers import percent
from truing.stages.quality.check import Check
from truing.stages.quality.limits import CampaignLimits

if TYPE_CHECKING:
    import pyarrow as pa


def quadrature_checks(channels: pa.Table, limits: CampaignLimits) -> Iterator[Check]:
    """Two checks of every channel."""
    for row in channels.to_pylist():
        yield _round(row, limits)
        yield _counted(row, limits)


def _round(row: dict[str, Any], limits: CampaignLimits) -> Check:
    share, uncut = row["radius_after"] / row["radius_mean"], row["radius_uncut"] / row["radius_mean"]
    name = row["channel"]
    said = (
        f"{name}: corrected by its ellipse, the radius of the raw signals scatters by {percent(100.0 * share)} of it."
    )
    if row["cut_share"] > 0.0:
        said += f" {percent(100.0 * row['cut_share'])} of the samples stand at an end of the converter's range;"
        said += f" the others scatter by {percent(100.0 * uncut)} about an ellipse of their own."
    return limits.of("signals-round").row(f"channel {name}", share, "1", said)


def _counted(row: dict[str, Any], limits: CampaignLimits) -> Check:
    risk, name = row["miscount_risk"], row["channel"]
    said = f"{name}: no step from sample to sample is likelier than {risk:.1g} to have been counted a fringe off."
    return limits.of("fringes-counted").row(f"channel {name}", risk, "1", said)
