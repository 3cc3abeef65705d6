"""The checks of a campaign's quality, one by one: docs/qa.md.

    python -m docs.experiments.quality_checks

writes them from their declarations in schemas/point_checks.py and schemas/load_checks.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from docs.experiments.marked_tables import renew, table
from truing.schemas.quality_check import CheckLimits, Checks, QualityCheck
from truing.schemas.quality_checks import CHECKS

_MARK = "settable"
PAGE = Path(__file__).parents[1] / "qa.md"


def overview(checks: Checks) -> str:
    """Return a table of all checks: from where on each warns and fails, and which limits may be set."""
    rows = [
        [
            f"`{name}`",
            one.question,
            one.criterion.warns or "–",
            one.criterion.fails or "–",
            _MARK * isinstance(one.criterion, CheckLimits),
            one.withholds,
        ]
        for name, one in checks.items()
    ]
    return table(["check", "what it asks", "warns", "fails", "", "withholds"], rows)


def entries(checks: Checks) -> str:
    """Return an entry of every check, under a heading of its name."""
    return "\n\n".join(_entry(name, check) for name, check in checks.items())


def _entry(name: str, check: QualityCheck) -> str:
    """Return why a check is made, the quantity of its settable limit, and what to do; limits are in the overview."""
    criterion = check.criterion
    quantity = f"- *Limit on*: {criterion.of}.\n" if isinstance(criterion, CheckLimits) else ""
    return f"### `{name}`\n\n**{check.question}** {check.why}\n\n{quantity}- *What to do*: {check.to_do}"


TABLES: Mapping[str, Callable[[], str]] = {
    "points": lambda: overview(CHECKS["photogrammetry"]),
    "loads": lambda: overview(CHECKS["interferometer"]),
    "every-check-of-points": lambda: entries(CHECKS["photogrammetry"]),
    "every-check-of-loads": lambda: entries(CHECKS["interferometer"]),
}

if __name__ == "__main__":
    renew(PAGE, TABLES)
