"""Quality of what was corrected in readings: is it known as well as the readings themselves?"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from truing.quality.loading import LoadingView
from truing.stages.quality.check import Check
from truing.stages.quality.limits import CampaignLimits

if TYPE_CHECKING:
    import pyarrow as pa


def correction_checks(view: LoadingView, corrections: pa.Table, limits: CampaignLimits) -> Iterator[Check]:
    """One check of every channel and correction whose uncertainty is declared."""
    noise = {channel.name: channel.declared * channel.in_files for channel in view.channels}
    for row in corrections.to_pylist():
        name, left = row["subject"], row["sigma"]
        if left is None or name not in noise:
            continue
        by = "" if row["largest"] is None else f" by {row['largest']:.2g} {row['unit']} at most, which"
        said = f"{name} is corrected for the {row['correction']}{by or ' as it came, which'}"
        said += f" is known to {left:.2g} {row['unit']} (one sigma)."
        limit = limits.of("corrections", per=noise[name])
        yield limit.row(f"channel {name} {row['correction']}", left, row["unit"], said)
