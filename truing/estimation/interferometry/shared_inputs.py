"""Suspected gross errors that are effects: a curve of the loads predicts them, or they share an input.

Rows that share an input (direction of a load, level, run) are no independent slips. A suspect counts as a gross error
only under two conditions: no nonlinear term of the loads, fitted without suspects, predicts it, and suspects of its
channel do not accumulate where an input is shared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from truing.arrays import Array, Index, Mask
from truing.estimation.interferometry.recorded_steps import LOADS
from truing.estimation.patterns import InputGroups, patterns

_UNLIKELY = 1e-6  # p-value of a term, corrected for all terms that are tried
_MOST_TERMS = 6
_ROWS_PER_COLUMN = 3.0
_LEAST = 1e-6  # share of a column's length that other columns must leave of it
_EXPLAINED = 1.0 / 3.0  # share of a deviation that a prediction may leave
_LEVELS = (0.0, 0.5, 0.9)  # shares of the largest load above which rows are a group
_LEVELS_OF_TWO = (0.0, 0.3)
_NORMAL_MEDIAN = 0.6745


@dataclass(frozen=True)
class SharedInput:
    """Suspects of one channel that are no slips: steps (N,), what they share, and the probability of that by chance.

    is_predicted: nonlinear terms of the loads, listed in ``follows``, predict the suspects; else they form a pattern
    where ``follows`` holds, such as ``fx > 0``, or in the whole run of that number. deviation (N,): in sigmas.
    """

    channel: int
    rows: Index
    is_predicted: bool
    follows: str
    run: int | None
    deviation: Array
    p_value: float


@dataclass(frozen=True)
class LoadCourse:
    """Loads (B, 6) and run numbers (B,) of the steps, with labels of the runs."""

    load: Array
    run: Index

    @property
    def share(self) -> Array:
        """Loads over the largest one of their axis."""
        largest = np.abs(self.load).max(axis=0, initial=0.0)
        return np.asarray(self.load / np.where(largest > 0.0, largest, 1.0))

    def plain_columns(self) -> Array:
        """Zero of each run and the loaded axes (B, P)."""
        share = self.share
        zeros = self.run[:, None] == np.unique(self.run)
        return np.concatenate([zeros.astype(float), share[:, share.any(axis=0)]], axis=1)

    def terms(self) -> tuple[list[str], Array]:
        """Names and columns (B, T) of squares, moduli, cubes and products of loads."""
        share = self.share
        loaded = np.flatnonzero(share.any(axis=0)).tolist()
        columns = {}
        for k in loaded:
            columns[f"{LOADS[k]}^2"] = share[:, k] ** 2
            columns[f"|{LOADS[k]}|"] = np.abs(share[:, k])
            columns[f"{LOADS[k]}^3"] = share[:, k] ** 3
        for i, j in combinations(loaded, 2):
            columns[f"{LOADS[i]} {LOADS[j]}"] = share[:, i] * share[:, j]
        used = {name: column for name, column in columns.items() if np.ptp(column) > 0.0}
        return list(used), np.array(list(used.values())).T.reshape(len(share), -1)

    def groups(self) -> InputGroups:
        """Rows that share a direction of one or two loads, a high load or a run."""
        names, member, odd = zip(*self._each_group(), strict=True)
        return InputGroups(names, np.array(member), np.array(odd))

    def _each_group(self) -> Iterator[tuple[str | int, Mask, Array]]:
        """Yield common properties of rows with their mask (B,), and the signs (B,) of an effect odd in that load."""
        share, even = self.share, np.ones(len(self.load))
        loaded = np.flatnonzero(share.any(axis=0)).tolist()
        for k in loaded:
            for level in _LEVELS:
                for sign in (1.0, -1.0):
                    yield _beyond(k, sign, level), sign * share[:, k] > level, even
                if level:
                    yield f"|{LOADS[k]}| > {level:g} of its range", np.abs(share[:, k]) > level, np.sign(share[:, k])
        for i, j in combinations(loaded, 2):
            for first, second, level in product((1.0, -1.0), (1.0, -1.0), _LEVELS_OF_TWO):
                is_both = (first * share[:, i] > level) & (second * share[:, j] > level)
                yield f"{_beyond(i, first, level)} and {_beyond(j, second, level)}", is_both, even
        for number in np.unique(self.run):
            yield int(number), self.run == number, even


def _beyond(axis: int, sign: float, level: float) -> str:
    """Return the condition that a load is beyond a share of its range, with a sign."""
    limit = f"{sign * level:g} of its range" if level else "0"
    return f"{LOADS[axis]} {'>' if sign > 0.0 else '<'} {limit}"


def shared_inputs(course: LoadCourse, reading: Array, sigma: Array, off: Array, limit: float) -> list[SharedInput]:
    """Return the suspected ones of readings (B, K) that are effects of loads or runs.

    off (B, K): deviations of the suspects that made them so, in sigmas, 0 for all others; limit: that of a gross error.
    """
    if not off.any():
        return []
    plain, (names, terms), groups = course.plain_columns(), course.terms(), course.groups()
    suspected = off != 0.0
    found: list[SharedInput] = []
    for k in np.flatnonzero(suspected.any(axis=0)).tolist():
        observed = np.isfinite(reading[:, k])
        rows = np.flatnonzero(observed & suspected[:, k])
        unsuspected = observed & ~suspected[:, k]
        white = np.where(observed, reading[:, k] / sigma[:, k], 0.0)
        chosen, p_value = _significant_terms(plain[unsuspected], terms[unsuspected], white[unsuspected])
        columns = np.concatenate([plain, terms[:, chosen]], axis=1)
        deviation, wide = _predicted(columns, white, unsuspected, rows)
        if chosen:
            suspect = np.abs(off[rows, k])
            is_explained = (np.abs(deviation) < limit * wide) & (np.abs(deviation) < _EXPLAINED * suspect)
            if is_explained.any():
                used = ", ".join(names[place] for place in chosen)
                found.append(SharedInput(k, rows[is_explained], True, used, None, off[rows[is_explained], k], p_value))
            rows, deviation = rows[~is_explained], deviation[~is_explained]
        for pattern in patterns(groups, np.flatnonzero(observed), rows, deviation):
            words, number = ("", pattern.name) if isinstance(pattern.name, int) else (pattern.name, None)
            off_by = off[pattern.rows, k]
            found.append(SharedInput(k, pattern.rows, False, words, number, off_by, pattern.p_value))
    return found


def _significant_terms(plain: Array, terms: Array, values: Array) -> tuple[list[int], float]:
    """Return the terms (N, T) on which values (N,), in sigmas, depend besides plain columns (N, P), and their largest
    p-value. Terms are added one by one by an F test."""
    from scipy.special import fdtrc

    basis, chosen, largest = _basis(plain), list[int](), 0.0
    length = np.linalg.norm(terms, axis=0)
    unit = terms / np.where(length > 0.0, length, 1.0)
    while len(chosen) < _MOST_TERMS and len(values) >= _ROWS_PER_COLUMN * (basis.shape[1] + 1):
        residual = values - basis @ (basis.T @ values)
        apart = unit - basis @ (basis.T @ unit)
        squares = np.sum(apart**2, axis=0)
        gain = np.where(squares > _LEAST, (residual @ apart) ** 2 / np.maximum(squares, _LEAST), 0.0)
        best = int(gain.argmax()) if len(gain) else 0
        spare = len(values) - basis.shape[1] - 1
        after = float(residual @ residual) - (float(gain[best]) if len(gain) else 0.0)
        if not len(gain) or not after > 0.0:
            break
        p_value = float(fdtrc(1, spare, gain[best] / (after / spare))) * terms.shape[1]
        if p_value > _UNLIKELY:
            break
        chosen.append(best)
        largest = max(largest, p_value)
        basis = np.column_stack([basis, apart[:, best] / np.sqrt(squares[best])])
    return chosen, largest


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis (N, R) of columns (N, P)."""
    if not columns.size:
        return np.zeros((len(columns), 0))
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, size > _LEAST * max(float(size[0]), 1e-300)])


def _predicted(columns: Array, values: Array, fitted: Mask, rows: Index) -> tuple[Array, Array]:
    """Return deviations of rows from a fit to others, in sigmas, and the standard deviation (N,) of each.

    A row whose columns the others do not determine has an infinite standard deviation.
    """
    inverse = np.linalg.pinv(columns[fitted], rcond=_LEAST)
    left = values[fitted] - columns[fitted] @ (inverse @ values[fitted])
    scatter = max(1.0, float(np.median(np.abs(left))) / _NORMAL_MEDIAN) if len(left) else 1.0
    reach = columns[rows] @ inverse
    is_open = np.linalg.norm(columns[rows] - reach @ columns[fitted], axis=1) > np.sqrt(_LEAST)
    wide = np.where(is_open, np.inf, scatter * np.sqrt(1.0 + np.sum(reach**2, axis=1)))
    return np.asarray(values[rows] - reach @ values[fitted]), wide
