"""Which parameters cannot be told apart, by name.

The unidentifiable directions of an `Observability` span a space, of which singular vectors are an unreadable basis. A
reduced echelon form gives each direction a parameter of its own; what can be left out of a direction while it stays
unidentifiable is left out. Directions that are null come first, and are simplified only as far as they stay null.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truing.estimation.design.observability import Observability

_MOST_DIGITS = 9
_SHOWN_DIGITS = 3


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
