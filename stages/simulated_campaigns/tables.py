"""Results of many simulated campaigns as tables: detectable sizes, and detection rates by size."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pyarrow as pa

from truing.arrays import TableRow
from truing.inference.detectable import POWER
from truing.simulation.detection_trials import Curve, DetectionQuestion, Rate

NEARLY_ALWAYS = 0.95
_TEXTS = ("cause", "concerns", "parameter", "unit", "beside", "instead")
_COUNTS = ("campaigns",)


def sizes_table(curves: Iterable[Curve]) -> pa.Table:
    """A row per sort of effect: the size found with 80 and with 95 %, as theory expects it and as drawn campaigns show.

    Sizes are root mean squares of ``parameter`` in its unit, ``beside`` names parameters of other units that grow with
    it; bounds hold with a probability of 95 %.
    """
    return _table([_sizes_row(curve) for curve in curves], _SIZES)


def rates_table(curves: Iterable[Curve], alarms: Rate) -> pa.Table:
    """A row per sort of effect and size: counts found, named, and with the right subject; nothing hidden first."""
    rows = [_nothing_row(alarms)] if alarms.of else []
    rows += [row for curve in curves for row in _rate_rows(curve)]
    return _table(rows, _RATES)


_SORT = ("cause", "concerns", "parameter", "unit", "beside")
_SIZES = (
    *_SORT,
    *(f"{name}_{level}" for level in ("80", "95") for name in ("expected", "found", "lower", "upper")),
    "signal_to_noise_80",
    "instead",
)
_RATES = (
    *_SORT,
    "size",
    "signal_to_noise",
    "campaigns",
    "expected",
    *(f"{what}{bound}" for what in ("found", "named", "subject_right") for bound in ("", "_lower", "_upper")),
)


def _table(rows: Sequence[TableRow], names: Sequence[str]) -> pa.Table:
    kinds = {name: pa.string() if name in _TEXTS else pa.int64() if name in _COUNTS else pa.float64() for name in names}
    return pa.Table.from_pylist(rows, schema=pa.schema(list(kinds.items())))


def _kind_row(question: DetectionQuestion) -> dict[str, object]:
    sort, unit = question.kind, question.unit
    reported = {"parameter": unit.parameter, "unit": unit.unit, "beside": unit.beside}
    return {"cause": sort.kind, "concerns": sort.concerns, **reported}


def _sizes_row(curve: Curve) -> dict[str, object]:
    question, scale = curve.question, curve.question.unit.value
    row = _kind_row(question)
    for level, power in (("80", POWER), ("95", NEARLY_ALWAYS)):
        theory, seen = question.size_of(power), curve.size(power)
        row[f"expected_{level}"] = None if theory is None else theory * scale
        bounds = (None,) * 3 if seen is None else (seen.value * scale, seen.lower * scale, seen.upper * scale)
        row |= dict(zip((f"found_{level}", f"lower_{level}", f"upper_{level}"), bounds, strict=True))
    expected = question.expected
    row["signal_to_noise_80"] = None if expected is None else question.signal_to_noise(expected)
    row["instead"] = ", ".join(f"{text} ({count})" for text, count in curve.others_found[:3])
    return row


def _rate_rows(curve: Curve) -> list[TableRow]:
    question = curve.question
    return [
        {
            **_kind_row(question),
            "size": factor * (question.expected or 0.0) * question.unit.value,
            "signal_to_noise": question.signal_to_noise(factor * (question.expected or 0.0)),
            "campaigns": curve.found[index].of,
            "expected": question.rate(factor * (question.expected or 0.0)),
            **_rate_columns("found", curve.found[index]),
            **_rate_columns("named", curve.named[index]),
            **_rate_columns("subject_right", curve.subject_right[index]),
        }
        for index, factor in enumerate(curve.factors)
    ]


def _nothing_row(alarms: Rate) -> dict[str, object]:
    nothing = {**dict.fromkeys(_SORT, ""), "cause": "nothing", "size": 0.0, "signal_to_noise": 0.0}
    return {**nothing, "campaigns": alarms.of, **_rate_columns("found", alarms)}


def _rate_columns(outcome: str, rate: Rate) -> dict[str, object]:
    return {outcome: rate.value, f"{outcome}_lower": rate.bounds[0], f"{outcome}_upper": rate.bounds[1]}
