"""What measurements can tell about parameters before any is taken: which are inseparable, which set is identifiable.

Columns of the Jacobian are counted in tolerances and its rows in standard deviations of the noise. A singular value is
then a signal-to-noise ratio: how many sigma the data move when the parameters move by one tolerance along a direction,
and its inverse is the standard deviation that the data alone leave there, in tolerances.

The unidentifiable directions of an `Observability` span a space, of which singular vectors are an unreadable basis. A
reduced echelon form gives each direction a parameter of its own; what can be left out of a direction while it stays
unidentifiable is left out. Directions that are null come first, and are simplified only as far as they stay null.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Where the data alone know a direction no better than this many tolerances, they tell less than the drawing does.
UNIDENTIFIABLE = 1.0
_MOST_DIGITS = 9
_SHOWN_DIGITS = 3


@dataclass(frozen=True)
class Observability:
    """Singular values and directions of a scaled observability Jacobian of N rows and P parameters.

    labels, scales (P,): name and tolerance of each parameter. triangle (P, P): factor of the scaled Jacobian, which has
    its singular values and directions. singular_values (P,): descending. directions (P, P): a column for each, in
    tolerances. least: singular value up to which a direction counts as unidentifiable. rounding: the value that the
    computer's arithmetic alone may leave of a zero.
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
        """Return how many directions are identifiable."""
        return int(np.sum(self.singular_values > self.least))

    @property
    def condition(self) -> float:
        """Return the condition number, infinite where a direction is null to rounding."""
        if not len(self.singular_values):  # no parameter at all
            return np.inf
        first, last = self.singular_values[0], self.singular_values[-1]
        return float(first / last) if last > self.rounding else np.inf

    @property
    def unseen(self) -> NDArray:
        """Return the unidentifiable directions (P, P - rank), orthonormal, in tolerances."""
        return self.directions[:, self.rank :]

    @cached_property
    def sigma(self) -> NDArray:
        """Return the standard deviation (P,) that the data alone give, infinite where rounding hides a direction."""
        known = self.singular_values > self.rounding
        if not known.any():
            return np.full(len(self.scales), np.inf)
        scatter = self.directions[:, known] / self.singular_values[known]
        # A null direction is itself turned by rounding, at most so much, towards the seen ones (Davis and Kahan).
        turned = self.rounding / self.singular_values[known].min()
        hidden = np.any(np.abs(self.directions[:, ~known]) > turned, axis=1)
        return np.where(hidden, np.inf, self.scales * np.linalg.norm(scatter, axis=1))

    @cached_property
    def sigma_with_prior(self) -> NDArray:
        """Return the standard deviation (P,) that the data and the tolerances give together."""
        scatter = self.directions / np.hypot(self.singular_values, 1.0)
        return np.asarray(self.scales * np.linalg.norm(scatter, axis=1))

    @property
    def identifiable(self) -> NDArray:
        """Return which parameters (P,) the data alone determine, all others being free."""
        return self.sigma * self.least < self.scales

    def sensitivity(self, change: NDArray) -> NDArray:
        """Return by how many sigma, for one tolerance along them, changes (P, ...) in tolerances are seen (...)."""
        return np.asarray(np.linalg.norm(self.triangle @ change, axis=0) / np.linalg.norm(change, axis=0))


def observe(
    jacobian: NDArray,
    scales: ArrayLike,
    labels: Sequence[str],
    *,
    unidentifiable: float = UNIDENTIFIABLE,
    accuracy: float = np.finfo(float).eps,
) -> Observability:
    """Return what data with a whitened Jacobian (N, P) tell about P parameters of given tolerances (P,).

    A direction is unidentifiable where the data alone leave it ``unidentifiable`` tolerances or more uncertain: at 1
    the data halve the variance that the tolerances left, below they hardly touch it. Arithmetic bounds what can be
    told at all: entries of relative ``accuracy`` move no singular value by more than ``accuracy`` max(N, P) times the
    largest (Weyl), and what lies below that counts as zero. Both thresholds are invariant to units, to the order of
    rows and parameters and to rotations among the rows; rows that were not whitened make the first one meaningless.
    Raises ValueError for shapes that do not match, values that are not finite or scales that are not positive.
    """
    J, tolerance = np.asarray(jacobian, float), np.asarray(scales, float)
    if J.ndim != 2 or tolerance.shape != J.shape[1:] or len(labels) != J.shape[-1]:
        raise ValueError(f"found jacobian {J.shape}, scales {tolerance.shape}, {len(labels)} labels, expected (N, P)")
    if not np.isfinite(J).all() or not np.all(np.isfinite(tolerance) & (tolerance > 0)):
        raise ValueError("jacobian and scales have to be finite, and scales positive")
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
    log_determinant: log det J'J, which orders sets of as many poses as o1 does; the telescope report's O1, section 6.3.
    """

    o1: float
    o2: float
    o3: float
    o4: float
    o5: float
    log_determinant: float


def indices(singular_values: NDArray, poses: int) -> Indices:
    """Return the indices of m singular values (m,), descending, measured in a number of poses; zero where one is zero.

    All but the order by o1 and the log determinant change with the units of parameters that are not counted in
    tolerances. They are meant for an identifiable set: one unidentifiable direction rules all of them.
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
    """G parameters of which the data see only some combinations.

    changes (k, G): changes of the parameters, in their own units, that the data do not see, each 1 at a parameter that
    is its own, the others rounded as far as it stays unseen. sigma (k,): what the data alone leave uncertain along
    each, in tolerances; infinite where it is null to rounding. seen (G - k, G): the combinations that the data do see.
    """

    labels: tuple[str, ...]
    changes: NDArray
    sigma: NDArray
    seen: NDArray

    @property
    def text(self) -> str:
        """Return it in words: ``a_z3 − b_z3 + 1.03 l3 cannot be told apart``."""
        if len(self.seen) == 0:
            return f"{' and '.join(self.labels)} cannot be seen"
        if len(self.seen) == 1:
            return f"{_sum(self.labels, self.seen[0])} cannot be told apart"
        return "; ".join(self.texts)

    @property
    def texts(self) -> tuple[str, ...]:
        """Return each unseen change in words: ``a_x1 : u_x1 : kappa1 = −10.2 : 1 : 0.215 goes unseen``."""
        return tuple(f"{_ratio(self.labels, change)} goes unseen" for change in self.changes)


def inseparable(observability: Observability) -> tuple[Inseparable, ...]:
    """Return the groups of parameters that the data cannot tell apart, in the order of their first parameter.

    Each unidentifiable direction is expressed by as few parameters as keep it unidentifiable; directions that share a
    parameter make one group.
    """
    changes = sparse_directions(observability)
    return tuple(_group(observability, changes[rows]) for rows in _connected(changes != 0))


def sparse_directions(observability: Observability) -> NDArray:
    """Return the unidentifiable directions (k, P), in tolerances, each with a parameter that no other one has."""
    null = observability.directions[:, observability.singular_values <= observability.rounding]
    first, own = _simplified(observability, null, [], observability.rounding)
    unseen = observability.unseen
    if own:  # the weak directions, less what the null ones can take from them
        rest = np.linalg.svd(unseen[own])[2][len(own) :]
        unseen = unseen @ rest.T
    second, _ = _simplified(observability, unseen, own, observability.least)
    return np.concatenate([first, second])


def _simplified(
    observability: Observability, basis: NDArray, taken: list[int], least: float
) -> tuple[NDArray, list[int]]:
    """Return k directions (k, P) for a basis (P, k), without parameters that are taken, and the one that each owns."""
    own = pivots(basis.T)
    echelon = basis @ np.linalg.inv(basis[own]) if own else basis
    found = [_shortest(observability, b, p, [*taken, *own], least) for b, p in zip(echelon.T, own, strict=True)]
    return np.array(found).reshape(len(own), len(basis)), own


def pivots(rows: NDArray) -> list[int]:
    """Return for k rows (k, P) the k columns that a QR decomposition with column pivoting takes first."""
    left, found = np.array(rows), []
    for _ in range(len(rows)):
        found.append(int(np.argmax(np.sum(left**2, axis=0))))
        unit = left[:, found[-1]] / np.linalg.norm(left[:, found[-1]])
        left = left - np.outer(unit, unit @ left)
    return found


def _shortest(observability: Observability, direction: NDArray, pivot: int, own: list[int], least: float) -> NDArray:
    """Return a direction (P,), 1 at its own parameter, with few others and none that others have for themselves.

    Others come in one by one, always the one that hides most of what is still seen, until that is little enough; the
    smallest leave again where they turn out not to be needed.
    """
    kept, best = _hiding(observability, direction, pivot, own, least)
    for j in sorted(kept, key=lambda i: abs(best[i])):
        fewer = [other for other in kept if other != j]
        shorter = _expressed(observability, best, pivot, fewer, least)
        kept, best = (kept, best) if shorter is None else (fewer, shorter)
    return best


def _hiding(
    observability: Observability, direction: NDArray, pivot: int, own: list[int], least: float
) -> tuple[list[int], NDArray]:
    """Return parameters that hide a change of one, none of ``own``, and the change of all of them."""
    R, chosen = observability.triangle, list[int]()
    left, seen = R.copy(), R[:, pivot].copy()
    free = np.ones(len(direction), bool)
    free[own] = False
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
    return [int(j) for j in np.flatnonzero(direction) if j not in own], direction


def _expressed(
    observability: Observability, direction: NDArray, pivot: int, others: Sequence[int], least: float
) -> NDArray | None:
    """Return the least visible change (P,) of a parameter and some others, None where it is seen too well."""
    R, chosen = observability.triangle, list(others)
    candidates = np.zeros((len(direction), 2))  # fitted anew, or what is left of the direction
    candidates[pivot] = 1.0
    candidates[chosen, 0] = -np.linalg.lstsq(R[:, chosen], R[:, pivot])[0] if chosen else 0.0
    candidates[chosen, 1] = direction[chosen]
    unseen = np.flatnonzero(observability.sensitivity(candidates) <= least)
    return candidates[:, unseen[0]] if len(unseen) else None


def _connected(supports: NDArray) -> list[list[int]]:
    """Return the rows (k, P) that hang together by common columns, in the order of their first columns."""
    groups: list[tuple[NDArray, list[int]]] = []
    for row, support in enumerate(supports):
        touching = [group for group in groups if np.any(group[0] & support)]
        groups = [group for group in groups if not np.any(group[0] & support)]
        joined = np.any([support, *(columns for columns, _ in touching)], axis=0)
        groups.append((joined, [*(r for _, rows in touching for r in rows), row]))
    return [sorted(rows) for _, rows in sorted(groups, key=lambda group: int(np.argmax(group[0])))]


def _group(observability: Observability, changes: NDArray) -> Inseparable:
    """Return the group of some sparse directions (k, P)."""
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
        kept = observability.sensitivity(trials / observability.scales[:, None]) <= least
        out = trials[:, np.argmax(kept)] if kept.any() else out
    return out


def _complement(changes: NDArray) -> NDArray:
    """Return the combinations (G - k, G) that changes (k, G) leave alone, each with its first coefficient at 1."""
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
    """A set to which no parameter can be added without losing an identifiable direction.

    order: indices of the chosen parameters, the first taken first; chosen (P,): the same as a mask; observability: of
    the chosen parameters alone, in the order of the Jacobian.
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
    """Return a maximal set of parameters of which every direction is identifiable from a whitened Jacobian (N, P).

    Parameters are taken one by one: those of lower ``preference`` (P,) first, and among equals the one whose tolerance
    changes most that the parameters taken before cannot imitate (QR with column pivoting of the scaled Jacobian), so
    that of several that cannot be told apart the one of the largest tolerance is taken, which is the telescope report's
    rule (section 6.3.1). One that would leave a direction uncertain by ``unidentifiable`` tolerances or more is left
    out. Parameters with the same entry of ``groups`` enter together or not at all: every leg then has the same set;
    their volume in place of their length makes the order.
    Raises ValueError as `observe`, and where the groups' or preferences' number is not that of the parameters.
    """
    whole = observe(jacobian, scales, labels, unidentifiable=unidentifiable)
    members = _members(range(len(labels)) if groups is None else groups, len(labels))
    rank = np.zeros(len(labels)) if preference is None else np.asarray(preference, float)
    if rank.shape != whole.scales.shape:
        raise ValueError(f"found preferences of shape {rank.shape}, expected one for each of {len(labels)} parameters")
    order: list[int] = []
    left = whole.triangle
    while members:
        place, length = _next(left, members, rank)
        columns = members.pop(place)
        # no singular value is larger than what the columns taken before leave of a new one: most are refused by that
        if length > whole.least and _least(whole, [*order, *columns]) > whole.least:
            order += columns
            left = _without(left, left[:, columns])
    chosen = np.isin(np.arange(len(labels)), order)
    kept = [label for label, used in zip(labels, chosen, strict=True) if used]
    part = observe(np.asarray(jacobian)[:, chosen], whole.scales[chosen], kept, unidentifiable=unidentifiable)
    return IdentifiableSet(tuple(order), chosen, part)


def _members(groups: Sequence[object], count: int) -> list[list[int]]:
    """Return the columns of every group, in the order of their first ones."""
    if len(groups) != count:
        raise ValueError(f"found {len(groups)} entries of groups, expected one for each of {count} parameters")
    return [[j for j, name in enumerate(groups) if name == group] for group in dict.fromkeys(groups)]


def _next(left: NDArray, members: Sequence[list[int]], rank: NDArray) -> tuple[int, float]:
    """Return the group of the lowest preference number and, of these, of the largest volume in what is left.

    Its mean length as well, that of a cube of the volume, which is no shorter than what is least visible of the group.
    """
    lengths = np.linalg.norm(left, axis=0)
    sides = [lengths[group[0]] if len(group) == 1 else _side(left[:, group]) for group in members]
    place = min(range(len(members)), key=lambda i: (rank[members[i]].min(), -sides[i]))
    return place, float(sides[place])


def _side(columns: NDArray) -> float:
    """Return the side of a cube with the volume of columns (P, m)."""
    lengths = np.abs(np.diagonal(np.linalg.qr(columns, mode="r")))
    return float(np.exp(np.mean(np.log(np.maximum(lengths, np.finfo(float).tiny)))))


def _least(whole: Observability, columns: Sequence[int]) -> float:
    return float(np.linalg.svd(whole.triangle[:, list(columns)], compute_uv=False)[-1])


def _without(left: NDArray, taken: NDArray) -> NDArray:
    """Return columns (P, P) less what the taken ones (P, m) can imitate."""
    basis = np.linalg.qr(taken)[0]
    return left - basis @ (basis.T @ left)
