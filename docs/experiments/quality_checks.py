"""The checks of a campaign's quality, one by one: docs/qa.md.

    python -m docs.experiments.quality_checks

writes them from their declarations in schemas/checks_of_points.py, checks_of_photographs.py and checks_of_loads.py.
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
            one.asks,
            one.judged.warns or "–",
            one.judged.fails or "–",
            _MARK * isinstance(one.judged, CheckLimits),
            one.withholds,
        ]
        for name, one in checks.items()
    ]
    return table(["check", "what it asks", "warns", "fails", "", "withholds"], rows)


def entries(checks: Checks) -> str:
    """Return an entry of every check, under a heading of its name."""
    return "\n\n".join(_entry(name, check) for name, check in checks.items())


def _entry(name: str, check: QualityCheck) -> str:
    held = f" While it fails, {check.stages_withheld} are not evaluated." if check.withholds else ""
    return (
        f"### `{name}`\n\n**{check.asks}** {check.why}\n\n"
        f"- *Limit*: {_limit(check)}\n- *When it trips*: {check.to_do}{held}"
    )


def _limit(check: QualityCheck) -> str:
    judged = check.judged
    verdicts = "; ".join(
        f"{verb} {words}" for verb, words in (("warns", judged.warns), ("fails", judged.fails)) if words
    )
    if isinstance(judged, CheckLimits):
        return f"{judged.of}: {verdicts}. Settable."
    return f"{verdicts or 'none; it tells what cannot be evaluated'}."


TABLES: Mapping[str, Callable[[], str]] = {
    "points": lambda: overview(CHECKS["photogrammetry"]),
    "loads": lambda: overview(CHECKS["interferometer"]),
    "every-check-of-points": lambda: entries(CHECKS["photogrammetry"]),
    "every-check-of-loads": lambda: entries(CHECKS["interferometer"]),
}

if __name__ == "__main__":
    renew(PAGE, TABLES)
