"""Effects that a campaign's calibration includes or lists, by the choices in campaign.toml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

APPLIED = "applied"
AS_RECORDED, WITH_FINDINGS = "as recorded", "with findings"  # data of a calibration


@dataclass(frozen=True)
class AppliedFindings:
    """Text of an extended model (None if there is none), and whether the main calibration includes its effects; if not,
    the data are calibrated as recorded."""

    text: str | None
    is_main: bool


def applied_findings(tables: Mapping[str, pa.Table | str]) -> AppliedFindings:
    """Effects from the diagnosis of a campaign: those applied in campaign.toml, else all found."""
    choices = tables.get("diagnosis_choices")
    rows = [] if choices is None or isinstance(choices, str) else choices.to_pylist()
    text = tables.get("applied_model", tables.get("model"))
    is_main = any(row["outcome"] == APPLIED for row in rows)
    return AppliedFindings(text if isinstance(text, str) else None, is_main and isinstance(text, str))
