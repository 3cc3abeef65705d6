"""The effects that a campaign's calibration holds, or that stand beside it, by the choices in campaign.toml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

APPLIED = "applied"
AS_RECORDED, WITH_FINDINGS = "as recorded", "with findings"  # what a calibration is of


@dataclass(frozen=True)
class AppliedFindings:
    """The text of an extended model, None where there is none, and whether the main calibration holds its effects.

    Where it does not, what is calibrated is the data as recorded, and the effects stand beside it.
    """

    text: str | None
    is_main: bool


def applied_findings(tables: Mapping[str, pa.Table | str]) -> AppliedFindings:
    """The effects that the diagnosis left of a campaign: those that were asked for, else all that were found."""
    choices = tables.get("diagnosis_choices")
    rows = [] if choices is None or isinstance(choices, str) else choices.to_pylist()
    text = tables.get("applied_model", tables.get("model"))
    is_main = any(row["outcome"] == APPLIED for row in rows)
    return AppliedFindings(text if isinstance(text, str) else None, is_main and isinstance(text, str))
