"""Tables and figure of docs/power.md, generated from the results of ``benchmarks.power_agreement``."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from docs.experiments.marked_tables import renew, table
from tests.blind.two_rates import Pair, unlike
from truing.estimation.dose_response import rate_bounds

PROJECT = Path(__file__).resolve().parents[1]
PAGE = PROJECT / "docs" / "power.md"
FIGURE = PROJECT / "docs" / "figures" / "power-agreement.svg"
KEPT = PROJECT / "docs" / "experiments" / "power_agreement.jsonl.gz"  # what the page was made from
BOTH = ("power", "generator")
COLOURS = {"power": "#0072b2", "generator": "#d55e00"}

Record = dict[str, Any]


def write_page(records: Sequence[Record]) -> None:
    """Make tables and figure of the page anew, and keep the results that they were made from."""
    lines = "".join(json.dumps(record) + "\n" for record in sorted(records, key=lambda one: str(one["key"])))
    KEPT.write_bytes(gzip.compress(lines.encode(), mtime=0))
    own = kept_records()
    renew(PAGE, tables(own))
    FIGURE.write_text(figure(own), encoding="utf-8")


def kept_records() -> list[Record]:
    """Return the results that the page was made from."""
    return [json.loads(line) for line in gzip.decompress(KEPT.read_bytes()).decode().splitlines()]


def tables(records: Sequence[Record]) -> dict[str, Callable[[], str]]:
    """Return the functions that build the tables of the page, by name."""
    return {"agreement": lambda: agreement(records), "sizes": lambda: by_size(records)}


def pairs(records: Iterable[Record], what: str = "found") -> list[Pair]:
    """Return the counts of either, one pair per layout, sort of effect and size: each at a rate of its own."""
    groups: dict[tuple[Any, ...], list[Record]] = {}
    for record in records:
        groups.setdefault(tuple(record[name] for name in _CELL), []).append(record)
    return [_pair(group, what) for group in groups.values()]


_CELL = ("layout", "cause", "concerns", "parameter", "factor")


def _pair(own: Sequence[Record], what: str) -> Pair:
    return Pair(_count(own, "power", what), len(own), _count(own, "generator", what), len(own))


def _count(records: Iterable[Record], who: str, what: str) -> int:
    return sum(bool(record[who][what]) for record in records)


def agreement(records: Sequence[Record]) -> str:
    """Return the table of what was found of every sort of effect, and of all."""
    sorts: dict[tuple[str, str, str], list[Record]] = {}
    for record in records:
        sorts.setdefault((record["cause"].replace("-", " "), record["concerns"], record["parameter"]), []).append(
            record
        )
    rows = [[*sort[:2], *_row(own)] for sort, own in sorted(sorts.items())]
    return table(
        ["cause", "concerns", "pairs", "theory", "`truing power`", "generator", "chance of as much", "named", "chance"],
        [*rows, ["all", "", *_row(records)]],
    )


def by_size(records: Sequence[Record]) -> str:
    """Return the table of what was found by size, all sorts together."""
    factors = sorted({record["factor"] for record in records})
    rows = [
        [f"{factor:g}", *_row([record for record in records if record["factor"] == factor])[:-2]] for factor in factors
    ]
    return table(["size over theory's", "pairs", "theory", "`truing power`", "generator", "chance of as much"], rows)


def _row(own: Sequence[Record]) -> list[str]:
    theory = float(np.mean([one["theory"] for one in own]))
    found = [_reported(_count(own, who, "found"), len(own)) for who in BOTH]
    named = " / ".join(str(_count(own, who, "named")) for who in BOTH)
    chance = [f"{unlike(pairs(own, what)):.2f}" for what in ("found", "named")]
    return [str(len(own)), f"{theory:.0%}", *found, chance[0], named, chance[1]]


def _reported(count: int, of: int) -> str:
    low, high = rate_bounds(count, of)
    return f"{count} ({low:.0%} to {high:.0%})"


def figure(records: Sequence[Record]) -> str:
    """Return rates by size as SVG: both with their exact 95 % bounds with the theoretical rate."""
    factors = sorted({record["factor"] for record in records})
    low, high = np.log(factors[0] / 1.15), np.log(factors[-1] * 1.15)

    def at(factor: float, rate: float) -> tuple[float, float]:
        return 60 + 380 * (np.log(factor) - low) / (high - low), 250 - 220 * rate

    parts = []
    for rate in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = at(factors[0], rate)[1]
        parts += [f'<path d="M60,{y:.1f}h380" stroke="#ddd"/>', _text(54, y + 4, f"{rate:.0%}", "end")]
    parts += [_text(at(factor, 0)[0], 268, f"{factor:g}") for factor in factors]
    parts.append(_text(250, 290, "size over that which theory expects to be found with 80 %"))
    groups = [[record for record in records if record["factor"] == factor] for factor in factors]
    line = [at(f, float(np.mean([one["theory"] for one in own]))) for f, own in zip(factors, groups, strict=True)]
    polyline = " ".join(f"{x:.1f},{y:.1f}" for x, y in line)
    parts.append(f'<polyline points="{polyline}" fill="none" stroke="#000" stroke-dasharray="6 4"/>')
    for side, who in ((-5, "power"), (5, "generator")):
        for factor, group in zip(factors, groups, strict=True):
            count = _count(group, who, "found")
            x, y = at(factor, count / len(group))
            down, up = (at(factor, bound)[1] for bound in rate_bounds(count, len(group)))
            parts.append(f'<path d="M{x + side:.1f},{down:.1f}V{up:.1f}" stroke="{COLOURS[who]}" stroke-width="2"/>')
            parts.append(f'<circle cx="{x + side:.1f}" cy="{y:.1f}" r="4" fill="{COLOURS[who]}"/>')
    for k, (name, colour) in enumerate({"truing power": "power", "generator": "generator"}.items()):
        parts += [f'<circle cx="{80 + 130 * k}" cy="310" r="4" fill="{COLOURS[colour]}"/>']
        parts += [_text(90 + 130 * k, 314, name, "start")]
    parts += ['<path d="M330,310h24" stroke="#000" stroke-dasharray="6 4"/>', _text(360, 314, "theory", "start")]
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="460" height="325" font-family="sans-serif" font-size="12">'
    return "\n".join([head, '<rect width="460" height="325" fill="white"/>', *parts, "</svg>\n"])


def _text(x: float, y: float, words: str, anchor: str = "middle") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{words}</text>'
