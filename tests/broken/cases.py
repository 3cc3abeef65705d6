"""Every broken campaign, and a command that writes them for a look: ``python -m tests.broken DIR``."""

from __future__ import annotations

from pathlib import Path

from tests.broken import (
    axis_tables,
    campaign_files,
    hostile_files,
    load_tables,
    mistaken_values,
    no_files,
    ordinary_life,
    point_tables,
)
from tests.broken.good import CAMPAIGNS
from tests.broken.spoiling import Broken

CASES: tuple[Broken, ...] = (
    *campaign_files.CASES,
    *point_tables.CASES,
    *load_tables.CASES,
    *axis_tables.CASES,
    *hostile_files.CASES,
    *no_files.CASES,
    *ordinary_life.CASES,
    *mistaken_values.CASES,
)


def write_broken(case: Broken, folder: Path) -> Path:
    """Write the good campaign into a folder that is not there yet, and spoil it."""
    campaign = CAMPAIGNS[case.of](folder)
    case.spoil(campaign)
    return campaign
