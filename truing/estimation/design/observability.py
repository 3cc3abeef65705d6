"""Observability before measuring: inseparable parameters and identifiable sets from a Jacobian.

Columns of the Jacobian are in tolerances and rows in standard deviations of the noise. A singular value is then a
signal-to-noise ratio: the change of the data in sigma when the parameters move by one tolerance along a direction. Its
inverse is the standard deviation from the data alone, in tolerances.

Unidentifiable directions span a space for which singular vectors are an unreadable basis. A reduced echelon form gives
each direction its own parameter, and removes parameters while the direction stays unidentifiable. Null directions come
first, and are simplified only as far as they stay null.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Standard deviation from data, in tolerances, from which the data say less than the drawing.
UNIDENTIFIABLE = 1.0
_MOST_DIGITS = 9
_SHOWN_DIGITS = 3


@dataclass(frozen=True)
class Observability:
    """Singular values and directions of a scaled observability Jacobian of N rows and P parameters.

    labels, scales (P,): name and tolerance of each parameter. triangle (P, P): triangular factor of the scaled
    Jacobian, with the same singular values and directions. singular_values (P,): descending. directions (P, P):
    columns, in tolerances. least: largest singular value that counts as unidentifiable. rounding: value that rounding
    may leave of a zero.
    """

    labels: tuple[str, ...]
    scales: NDArray
    triangle: NDArray
    singular_values: NDArray
    directions: NDArray
    least: float
    rounding: float

    @property
    def rank(self) -> int:
        """Number of identifiable directions."""
        return int(np.sum(self.singular_values > self.least))

    @property
    def condition(self) -> float:
        """Condition number, infinite if a direction is null to rounding."""
        if not len(self.singular_values):  # no parameters
            return np.inf
        first, last = self.singular_values[0], self.singular_values[-1]
        return float(first / last) if last > self.rounding else np.inf

    @property
    def unidentifiable(self) -> NDArray:
        """Unidentifiable directions (P, P - rank), orthonormal, in tolerances."""
        return self.directions[:, self.rank :]

    @cached_property
    def sigma(self) -> NDArray:
        """Standard deviation (P,) from the data alone, infinite if rounding hides a direction."""
        known = self.singular_values > self.rounding
        if not known.any():
            return np.full(len(self.scales), np.inf)
        scatter = self.directions[:, known] / self.singular_values[known]
        # Rounding rotates a null direction towards the seen ones by at most this (Davis and Kahan).
        turned = self.rounding / self.singular_values[known].min()
        hidden = np.any(np.abs(self.directions[:, ~known]) > turned, axis=1)
        return np.where(hidden, np.inf, self.scales * np.linalg.norm(scatter, axis=1))

    @cached_property
    def sigma_with_prior(self) -> NDArray:
        """Standard deviation (P,) from data and tolerances together."""
        scatter = self.directions / np.hypot(self.singular_values, 1.0)
        return np.asarray(self.scales * np.linalg.norm(scatter, axis=1))

    @property
    def identifiable(self) -> NDArray:
        """Mask (P,) of parameters that the data alone determine, with all others free."""
        return self.sigma * self.least < self.scales

    def sensitivity(self, change: NDArray) -> NDArray:
        """Return the change of the data (...) in sigma by changes (P, ...) of the parameters in tolerances."""
        return np.asarray(np.linalg.norm(self.triangle @ change, axis=0) / np.linalg.norm(change, axis=0))


def observe(
    jacobian: NDArray,
    scales: ArrayLike,
    labels: Sequence[str],
    *,
    unidentifiable: float = UNIDENTIFIABLE,
    accuracy: float = np.finfo(float).eps,
) -> Observability:
    """Return the observability of P parameters of given tolerances (P,) from a whitened Jacobian (N, P).

    A direction is unidentifiable if the data alone leave it ``unidentifiable`` or more tolerances uncertain: at 1 the
    data halve the variance of the tolerances. Rounding limits this: entries of relative ``accuracy`` move no singular
    value by more than ``accuracy`` max(N, P) times the largest (Weyl), and smaller values count as zero. Both
    thresholds are invariant to units, order of rows and parameters, and rotations among the rows; rows that are not
    whitened make the first one meaningless. Raises ValueError for shapes that do not match, values that are not finite
    or scales that are not positive.
    """
    J, tolerance = np.asarray(jacobian, float), np.asarray(scales, float)
    if J.ndim != 2 or tolerance.shape != J.shape[1:] or len(labels) != J.shape[-1]:
        raise ValueError(f"found jacobian {J.shape}, scales {tolerance.shape}, {len(labels)} labels, expected (N, P)")
    if not np.isfinite(J).all() or not np.all(np.isfinite(tolerance) & (tolerance > 0)):
        raise ValueError("expected a finite jacobian and finite positive scales")
    triangle = _triangle(J * tolerance)
    _, values, rows = np.linalg.svd(triangle)
    rounding = accuracy * max(J.shape) * float(values.max(initial=0.0))
    least = max(1.0 / unidentifiable, rounding)
    return Observability(tuple(labels), tolerance, triangle, values, rows.T, least, rounding)


def _triangle(scaled: NDArray) -> NDArray:
    """Return the triangular factor (P, P), rows of zeros where there are fewer measurements than parameters."""
    factor = np.linalg.qr(scaled, mode="r")
    return np.concatenate([factor, np.zeros((scaled.shape[1] - len(factor), scaled.shape[1]))])


@dataclass(frozen=True)
class Indices:
    """Observability indices of the calibration literature, from m singular values and a number n of poses.

    o1: (s_1 ... s_m)^(1/m) / sqrt(n), Borm and Menq, Int. J. Robotics Research 10 (1991) 51 (D-optimality).
    o2: s_m / s_1, Driels and Pathre, J. Robotic Systems 7 (1990) 155.
    o3: s_m, Nahvi, Hollerbach and Hayward, IEEE ICRA (1994) 985 (E-optimality).
    o4: s_m^2 / s_1, the noise amplification index, Nahvi and Hollerbach, IEEE ICRA (1996) 647.
    o5: 1 / (1/s_1 + ... + 1/s_m), Sun and Hollerbach, IEEE ICRA (2008) 831 (related to A-optimality).
    log_determinant: log det J'J, with the same order as o1 at an equal number of poses; O1 of the telescope report,
    section 6.3.
    """

    o1: float
    o2: float
    o3: float
    o4: float
    o5: float
    log_determinant: float


def indices(singular_values: NDArray, poses: int) -> Indices:
    """Return the indices of m singular values (m,), descending, of a number of poses; zero if one is zero.

    Except for the order by o1 and the log determinant, they change with the units of parameters not scaled by
    tolerances. Use them for an identifiable set: one unidentifiable direction dominates all of them.
    """
    s = np.asarray(singular_values, float)
    if not len(s) or s[-1] <= 0:
        return Indices(0.0, 0.0, 0.0, 0.0, 0.0, -np.inf)
    logs = np.log(s)
    o1 = np.exp(logs.mean()) / np.sqrt(poses)
    figures = (o1, s[-1] / s[0], s[-1], s[-1] ** 2 / s[0], 1.0 / np.sum(1.0 / s), 2.0 * logs.sum())
    return Indices(*map(float, figures))


@dataclass(frozen=True)
class Inseparable:
    """G parameters of which the data determine only some combinations.

    changes (k, G): changes of the parameters, in their own units, that the data do not see; each is 1 at its own
    parameter, others are rounded as far as it stays unseen. sigma (k,): standard deviation of each from the data alone,
    in tolerances; infinite if null to rounding. determined (G - k, G): combinations that the data determine.
    """

    labels: tuple[str, ...]
    changes: NDArray
    sigma: NDArray
    determined: NDArray

    @property
    def text(self) -> str:
        """Return the combination in words: ``only a_z3 − b_z3 + 1.03 l3 is determined``."""
        if len(self.determined) == 0:
            verb = "is" if len(self.labels) == 1 else "are"
            return f"{' and '.join(self.labels)} {verb} unobservable"
        if len(self.determined) == 1:
            return f"only {_sum(self.labels, self.determined[0])} is determined"
        return "; ".join(self.texts)

    @property
    def texts(self) -> tuple[str, ...]:
        """Return each unseen change in words: ``a_x1 : u_x1 : kappa1 = −10.2 : 1 : 0.215 is unobservable``."""
        return tuple(f"{_ratio(self.labels, change)} is unobservable" for change in self.changes)


def inseparable(observability: Observability) -> tuple[Inseparable, ...]:
    """Return the groups of parameters that the data cannot separate, in the order of their first parameter.

    Each unidentifiable direction uses as few parameters as possible; directions that share a parameter form one group.
    """
    changes = sparse_directions(observability)
    return tuple(_group(observability, changes[rows]) for rows in _connected(changes != 0))


def sparse_directions(observability: Observability) -> NDArray:
    """Return the unidentifiable directions (k, P), in tolerances, each with a parameter that no other one has."""
    null = observability.directions[:, observability.singular_values <= observability.rounding]
    first, pivots_of_null = _simplified(observability, null, [], observability.rounding)
    unseen = observability.unidentifiable
    if pivots_of_null:  # weak directions, after removing null directions from them
        complement = np.linalg.svd(unseen[pivots_of_null])[2][len(pivots_of_null) :]
        unseen = unseen @ complement.T
    second, _ = _simplified(observability, unseen, pivots_of_null, observability.least)
    return np.concatenate([first, second])


def _simplified(
    observability: Observability, basis: NDArray, excluded: list[int], least: float
) -> tuple[NDArray, list[int]]:
    """Return k directions (k, P) for a basis (P, k), without parameters that are taken, and each one's own
    parameter."""
    pivots_of_basis = pivots(basis.T)
    echelon = basis @ np.linalg.inv(basis[pivots_of_basis]) if pivots_of_basis else basis
    shortest = [
        _shortest(observability, b, p, [*excluded, *pivots_of_basis], least)
        for b, p in zip(echelon.T, pivots_of_basis, strict=True)
    ]
    return np.array(shortest).reshape(len(pivots_of_basis), len(basis)), pivots_of_basis


def pivots(rows: NDArray) -> list[int]:
    """Return the k columns that QR with column pivoting takes first from rows (k, P)."""
    left, result = np.array(rows), []
    for _ in range(len(rows)):
        result.append(int(np.argmax(np.sum(left**2, axis=0))))
        unit = left[:, result[-1]] / np.linalg.norm(left[:, result[-1]])
        left = left - np.outer(unit, unit @ left)
    return result


def _shortest(
    observability: Observability, direction: NDArray, pivot: int, excluded: list[int], least: float
) -> NDArray:
    """Return a direction (P,), 1 at its own parameter, with few others and no other direction's own parameter.
    Parameters are added one by one, each the one that hides most of the visible part, until it is small enough; then
    small unneeded ones are removed."""
    used, best = _compensating_parameters(observability, direction, pivot, excluded, least)
    for j in sorted(used, key=lambda i: abs(best[i])):
        fewer = [other for other in used if other != j]
        shorter = _expressed(observability, best, pivot, fewer, least)
        used, best = (used, best) if shorter is None else (fewer, shorter)
    return best


def _compensating_parameters(
    observability: Observability, direction: NDArray, pivot: int, excluded: list[int], least: float
) -> tuple[list[int], NDArray]:
    """Return parameters that hide a change of one, none of ``excluded``, and the change of all of them."""
    R, chosen = observability.triangle, list[int]()
    left, seen = R.copy(), R[:, pivot].copy()
    free = np.ones(len(direction), bool)
    free[excluded] = False
    for _ in range(int(free.sum()) + 1):
        hidden = _expressed(observability, direction, pivot, chosen, least)
        if hidden is not None:
            return chosen, hidden
        lengths = np.linalg.norm(left, axis=0)
        useful = free & (lengths > observability.rounding)
        if not useful.any():
            break
        gain = np.where(useful, np.abs(seen @ left) / np.where(useful, lengths, 1.0), -1.0)
        chosen.append(int(np.argmax(gain)))
        unit = left[:, chosen[-1]] / lengths[chosen[-1]]
        left, seen, free[chosen[-1]] = left - np.outer(unit, unit @ left), seen - unit * (unit @ seen), False
    return [int(j) for j in np.flatnonzero(direction) if j not in excluded], direction


def _expressed(
    observability: Observability, direction: NDArray, pivot: int, remaining: Sequence[int], least: float
) -> NDArray | None:
    """Return the least visible change (P,) of a parameter and some others, None if it is too visible."""
    R, chosen = observability.triangle, list(remaining)
    candidates = np.zeros((len(direction), 2))  # fitted again, or the rest of the direction
    candidates[pivot] = 1.0
    candidates[chosen, 0] = -np.linalg.lstsq(R[:, chosen], R[:, pivot])[0] if chosen else 0.0
    candidates[chosen, 1] = direction[chosen]
    unseen = np.flatnonzero(observability.sensitivity(candidates) <= least)
    return candidates[:, unseen[0]] if len(unseen) else None


def _connected(supports: NDArray) -> list[list[int]]:
    """Return the connected groups of rows (k, P) that share columns, in the order of their first columns."""
    groups: list[tuple[NDArray, list[int]]] = []
    for row, support in enumerate(supports):
        touching = [group for group in groups if np.any(group[0] & support)]
        groups = [group for group in groups if not np.any(group[0] & support)]
        joined = np.any([support, *(columns for columns, _ in touching)], axis=0)
        groups.append((joined, [*(r for _, rows in touching for r in rows), row]))
    return [sorted(rows) for _, rows in sorted(groups, key=lambda group: int(np.argmax(group[0])))]


def _group(observability: Observability, changes: NDArray) -> Inseparable:
    """Return the group of sparse directions (k, P)."""
    members = np.flatnonzero(np.any(changes != 0, axis=0))
    seen_by = observability.sensitivity(changes.T)
    sigma = np.array([1.0 / s if s > observability.rounding else np.inf for s in seen_by])
    rounded = np.stack([_rounded(observability, change) for change in changes])[:, members]
    return Inseparable(tuple(observability.labels[j] for j in members), rounded, sigma, _complement(rounded))


def _rounded(observability: Observability, change: NDArray) -> NDArray:
    """Return a direction (P,) in the parameters' units, each coefficient with as few digits as keep it unseen."""
    least = max(float(observability.sensitivity(change)), observability.least)
    out = change * observability.scales
    out = out / out[np.argmax(change == 1.0)]
    for j in np.flatnonzero(out):
        trials = np.repeat(out[:, None], _MOST_DIGITS, axis=1)
        trials[j] = [float(f"{out[j]:.{digits}g}") for digits in range(1, _MOST_DIGITS + 1)]
        mask = observability.sensitivity(trials / observability.scales[:, None]) <= least
        out = trials[:, np.argmax(mask)] if mask.any() else out
    return out


def _complement(changes: NDArray) -> NDArray:
    """Return the combinations (G - k, G) that changes (k, G) leave constant, each with its first coefficient at 1."""
    norms = np.linalg.norm(changes, axis=0)
    basis = np.linalg.svd(changes / norms)[2][len(changes) :] / norms
    basis = np.where(np.abs(basis) > 1e-9 * np.abs(basis).max(initial=0.0), basis, 0.0)
    first = np.argmax(basis != 0, axis=1)
    return basis / basis[np.arange(len(basis)), first][:, None]


def _sum(labels: Sequence[str], coefficients: NDArray) -> str:
    terms = [(c, f"{_factor(abs(c))}{label}") for label, c in zip(labels, coefficients, strict=True) if c != 0]
    return terms[0][1] + "".join(f" {'−' if c < 0 else '+'} {word}" for c, word in terms[1:])


def _factor(size: float) -> str:
    shown = f"{size:.{_SHOWN_DIGITS}g}"
    return "" if float(shown) == 1.0 else f"{shown} "


def _ratio(labels: Sequence[str], change: NDArray) -> str:
    terms = [(label, c) for label, c in zip(labels, change, strict=True) if c != 0]
    if len(terms) == 1:
        return terms[0][0]
    sizes = " : ".join(f"{c:.{_MOST_DIGITS}g}".replace("-", "−") for _, c in terms)
    return f"{' : '.join(label for label, _ in terms)} = {sizes}"


@dataclass(frozen=True)
class IdentifiableSet:
    """A set that no parameter can join without losing an identifiable direction.

    order: indices of the chosen parameters in the order of choice; chosen (P,): mask; observability: of the chosen
    parameters alone, in the order of the Jacobian.
    """

    order: tuple[int, ...]
    chosen: NDArray
    observability: Observability


def choose_identifiable(
    jacobian: NDArray,
    scales: ArrayLike,
    labels: Sequence[str],
    *,
    groups: Sequence[object] | None = None,
    preference: ArrayLike | None = None,
    unidentifiable: float = UNIDENTIFIABLE,
) -> IdentifiableSet:
    """Return a maximal set of parameters with all directions identifiable from a whitened Jacobian (N, P).

    Parameters are taken one by one: lower ``preference`` (P,) first. Among equals the one is taken whose tolerance
    changes most beyond the parameters before (QR with column pivoting of the scaled Jacobian). Of inseparable
    parameters this takes the one of the largest tolerance, the rule of the telescope report (section 6.3.1). A
    parameter that would leave a direction uncertain by ``unidentifiable`` or more tolerances is left out. Parameters
    with the same entry of ``groups`` enter together or not at all, for example one set for all legs; they are ordered
    by volume instead of length. Raises ValueError as `observe`, and for groups or preferences whose number is not that
    of the parameters.
    """
    observability = observe(jacobian, scales, labels, unidentifiable=unidentifiable)
    members = _members(range(len(labels)) if groups is None else groups, len(labels))
    rank = np.zeros(len(labels)) if preference is None else np.asarray(preference, float)
    if rank.shape != observability.scales.shape:
        raise ValueError(f"found preferences of shape {rank.shape}, expected one for each of {len(labels)} parameters")
    order: list[int] = []
    left = observability.triangle
    while members:
        index, length = _next_group(left, members, rank)
        columns = members.pop(index)
        # Quick bound: the residual of a new column limits the least singular value, and refuses most columns.
        if (
            length > observability.least
            and _smallest_singular_value(observability, [*order, *columns]) > observability.least
        ):
            order += columns
            left = _orthogonal_to(left, left[:, columns])
    chosen = np.isin(np.arange(len(labels)), order)
    labels_kept = [label for label, used in zip(labels, chosen, strict=True) if used]
    part = observe(
        np.asarray(jacobian)[:, chosen], observability.scales[chosen], labels_kept, unidentifiable=unidentifiable
    )
    return IdentifiableSet(tuple(order), chosen, part)


def _members(groups: Sequence[object], count: int) -> list[list[int]]:
    """Return the columns of each group, in the order of first columns."""
    if len(groups) != count:
        raise ValueError(f"found {len(groups)} entries of groups, expected one for each of {count} parameters")
    return [[j for j, name in enumerate(groups) if name == group] for group in dict.fromkeys(groups)]


def _next_group(left: NDArray, members: Sequence[list[int]], rank: NDArray) -> tuple[int, float]:
    """Return the group of the lowest preference number and, among these, of the largest volume in the remaining space.
    Also returns its mean length, the side of a cube of that volume: an upper bound of the least visible direction.
    """
    lengths = np.linalg.norm(left, axis=0)
    sides = [lengths[group[0]] if len(group) == 1 else _side(left[:, group]) for group in members]
    index = min(range(len(members)), key=lambda i: (rank[members[i]].min(), -sides[i]))
    return index, float(sides[index])


def _side(columns: NDArray) -> float:
    """Return the side of a cube with the volume of columns (P, m)."""
    lengths = np.abs(np.diagonal(np.linalg.qr(columns, mode="r")))
    return float(np.exp(np.mean(np.log(np.maximum(lengths, np.finfo(float).tiny)))))


def _smallest_singular_value(observability: Observability, columns: Sequence[int]) -> float:
    return float(np.linalg.svd(observability.triangle[:, list(columns)], compute_uv=False)[-1])


def _orthogonal_to(left: NDArray, chosen: NDArray) -> NDArray:
    """Return columns (P, P) minus their projection on the taken ones (P, m)."""
    basis = np.linalg.qr(chosen)[0]
    return left - basis @ (basis.T @ left)
