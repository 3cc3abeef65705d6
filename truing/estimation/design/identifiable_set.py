"""Choice of a set of parameters that data can identify, the others being held at their nominal values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truing.estimation.design.observability import UNIDENTIFIABLE, Observability, observe


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
