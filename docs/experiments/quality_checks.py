"""Tables of docs/qa.md: every quality check of a campaign.

    python -m docs.experiments.quality_checks

writes them from their declarations in schemas/point_checks.py and schemas/load_checks.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from docs.experiments.marked_tables import renew, table
from truing.schemas.quality_check import CheckLimits, Checks, QualityCheck
from truing.schemas.quality_checks import CHECKS

PAGE = Path(__file__).parents[1] / "qa.md"


def overview(checks: Checks) -> str:
    """Return a table of all checks: question, limits, the quantity of settable limits, and withheld results."""
    rows = [
        [
            f"`{name}`",
            one.question,
            one.criterion.warns or "–",
            one.criterion.fails or "–",
            one.criterion.of if isinstance(one.criterion, CheckLimits) else "",
            one.withholds,
        ]
        for name, one in checks.items()
    ]
    return table(["check", "what it asks", "warns", "fails", "settable limit on", "withholds"], rows)


def entries(checks: Checks, above: Checks = MappingProxyType({})) -> str:
    """Return a table of reason and remedy of every check; a check that equals one of ``above`` links to that table."""
    return table(["check", "why", "remedy"], [_entry(name, one, above.get(name)) for name, one in checks.items()])


def _entry(name: str, check: QualityCheck, above: QualityCheck | None) -> list[str]:
    equal = above is not None and (check.why, check.instructions) == (above.why, above.instructions)
    own = ["[as above](#every-check-of-object-points)", ""] if equal else [check.why, check.instructions]
    return [f"`{name}`", *own]


TABLES: Mapping[str, Callable[[], str]] = {
    "points": lambda: overview(CHECKS["photogrammetry"]),
    "loads": lambda: overview(CHECKS["interferometer"]),
    "every-check-of-points": lambda: entries(CHECKS["photogrammetry"]),
    "every-check-of-loads": lambda: entries(CHECKS["interferometer"], CHECKS["photogrammetry"]),
}

if __name__ == "__main__":
    renew(PAGE, TABLES)
