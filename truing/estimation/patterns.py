"""Patterns of outliers: where rows share an input, several outliers of one sign are an effect, and no single slips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truing.arrays import Array, Index, Mask

_FEWEST = 3  # outliers that form a pattern: any two share something
_BY_CHANCE = 0.01  # probability that independent slips form any pattern
_TOGETHER = 0.5  # share of the squares of a pattern's deviations that the others in it have to predict


@dataclass(frozen=True)
class InputGroups:
    """Groups of rows that share an input: what it is (a condition, or the number of a run), and the rows (G, B).

    odd (G, B): signs of an effect that changes its sign with the input; 1 elsewhere.
    """

    names: tuple[str | int, ...]
    member: Mask
    odd: Array


@dataclass(frozen=True)
class Pattern:
    """Outliers that share an input: their rows (N,), what it is, and the probability of that by chance."""

    rows: Index
    name: str | int
    p_value: float


def patterns(groups: InputGroups, observed: Index, rows: Index, deviation: Array) -> list[Pattern]:
    """Return the patterns of a channel's outliers at rows (N,), with their deviations, among all rows observed (M,)."""
    found: list[Pattern] = []
    while (pattern := _clearest(groups, observed, rows, deviation)) is not None:
        found.append(pattern)
        is_open = ~np.isin(rows, pattern.rows)
        rows, deviation = rows[is_open], deviation[is_open]
    return found


def _clearest(groups: InputGroups, observed: Index, rows: Index, deviation: Array) -> Pattern | None:
    """Return the input that most outliers share, far more than chance would have it; None without one.

    Slips fall on any of the observed rows, with either sign. Beyond that, the others in a pattern have to predict each
    of its deviations.
    """
    from scipy.stats import hypergeom

    best: Pattern | None = None
    size = groups.member[:, observed].sum(axis=1)
    for place in np.flatnonzero(groups.member[:, rows].sum(axis=1) >= _FEWEST).tolist():
        inside = groups.member[place, rows]
        count, signed = int(inside.sum()), deviation[inside] * groups.odd[place, rows[inside]]
        if abs(np.sign(signed).sum()) < count:
            continue
        by_chance = float(hypergeom.sf(count - 1, len(observed), int(size[place]), len(rows))) * 2.0 ** (1 - count)
        p_value = int(np.count_nonzero(size)) * by_chance
        mean_of_others = (signed.sum() - signed) / (count - 1)
        predicts = np.sum((signed - mean_of_others) ** 2) < _TOGETHER * np.sum(signed**2)
        if p_value < _BY_CHANCE and predicts and (best is None or (count, -p_value) > (len(best.rows), -best.p_value)):
            best = Pattern(rows[inside], groups.names[place], p_value)
    return best
