"""The smallest sizes that a campaign would have shown: rows of detectable.parquet, and the words of its sentences."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, cast

from truing.inference.detectable import POWER, Sight, sight, sights
from truing.schemas.artifacts import ARTIFACTS
from truing.simulation.detection_trials import told_size

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.inference.search import Search
    from truing.simulation.cause import Cause


def detectable_table(search: Search, level: float, legs: int) -> pa.Table:
    """Rows per cause, subject and parameter; ``search`` is the one in which nothing was left to be found."""
    import pyarrow as pa

    found: dict[tuple[str, ...], dict[str, Any]] = {}
    for own in sorted(sights(search, level), key=lambda s: len(s.cause.parameters(legs))):
        row = _row(own, legs)
        found.setdefault((row["cause"], row["subject"], row["parameter"], row["unit"]), row)
    return pa.Table.from_pylist(_ordered(found.values()), schema=ARTIFACTS["detectable"].arrow_schema())


def detectable_words(search: Search, level: float, causes: Iterable[Any], legs: int) -> dict[str, str]:
    """By a cause's key, the size that would have been found, in words; nothing of those that have no one size."""
    from truing.report.diagnosis.findings import detectable_words as in_words

    words = {}
    for cause in causes:
        own = sight(search, cause, level)
        if own is not None and cause.catalogued and (smallest := own.smallest()) is not None:
            size = told_size(cause, smallest, legs)
            words[cause.key] = in_words(size.parameter, size.value, size.unit)
    return words


def _row(own: Sight, legs: int) -> dict[str, Any]:
    smallest = own.smallest()
    size = told_size(cast("Cause", own.cause), 1.0 if smallest is None else smallest, legs)
    return {
        "cause": own.kind,
        "subject": own.cause.subject,
        "parameter": size.parameter,
        "size": None if smallest is None else size.value,
        "unit": size.unit,
        "power": POWER,
    }


def _ordered(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Causes as they come, the whole before single subjects."""
    listed = list(rows)
    causes = list(dict.fromkeys(row["cause"] for row in listed))
    return sorted(listed, key=lambda row: (causes.index(row["cause"]), bool(row["subject"])))
