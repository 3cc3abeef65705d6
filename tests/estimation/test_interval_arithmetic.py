"""Interval arithmetic: exact results lie within, and singular matrices are never called regular."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from truing.estimation.interval_arithmetic import (
    IntervalArray,
    around,
    cross,
    dot,
    hull,
    intervals,
    is_regular,
    product,
    tangent_of_half,
)


def drawn(rng: np.random.Generator, size: int = 300) -> tuple[np.ndarray, IntervalArray]:
    """Numbers of many sizes, and intervals that hold them."""
    value = rng.normal(size=size) * 10.0 ** rng.integers(-8, 9, size)
    reach = np.abs(value) * 10.0 ** rng.uniform(-16, 0.5, size)
    return value, hull(value - reach * rng.random(size), value + reach * rng.random(size))


def holds(found: IntervalArray, exact: list[Fraction]) -> bool:
    return all(
        Fraction(low) <= one <= Fraction(high)
        for low, one, high in zip(found.low.tolist(), exact, found.high.tolist(), strict=True)
    )


@pytest.mark.parametrize("name", ["+", "-", "*", "/"])
def test_exact_results_lie_within_the_bounds(name: str) -> None:
    rng = np.random.default_rng(1)
    (a, left), (b, right) = drawn(rng), drawn(rng)
    away = (right.low > 0) | (right.high < 0)
    operate = {"+": lambda x, y: x + y, "-": lambda x, y: x - y, "*": lambda x, y: x * y, "/": lambda x, y: x / y}[name]
    found = operate(left, right)
    keep = away if name == "/" else np.ones(len(a), bool)
    exact = [operate(Fraction(x), Fraction(y)) for x, y in zip(a[keep].tolist(), b[keep].tolist(), strict=True)]
    assert holds(found[keep], exact)
    if name == "/":
        assert np.isinf(found.low[~away]).all()
        assert (~away).any()


def test_exact_operands_give_neighbouring_bounds() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 100))
    for found in (intervals(a) + b, intervals(a) * b, intervals(a) - b):
        assert (found.high > found.low).all()
        assert (found.high - found.low <= 4 * np.spacing(np.abs(found.mid))).all()


def test_squares_and_roots_hold_the_exact_ones() -> None:
    value, interval = drawn(np.random.default_rng(3))
    squares = interval.squared()
    assert holds(squares, [Fraction(x) ** 2 for x in value.tolist()])
    assert (squares.low >= 0.0).all()
    roots = intervals(np.abs(value)).root()
    for low, one, high in zip(roots.low.tolist(), value.tolist(), roots.high.tolist(), strict=True):
        assert Fraction(low) ** 2 <= abs(Fraction(one)) <= Fraction(high) ** 2


def test_products_of_vectors_and_matrices_hold_those_of_their_members() -> None:
    rng = np.random.default_rng(4)
    A, B = rng.normal(size=(20, 4, 3)), rng.normal(size=(20, 3, 5))
    half = 0.1
    members = A + half * rng.uniform(-1, 1, A.shape), B + half * rng.uniform(-1, 1, B.shape)
    found = product(around(A, half), around(B, half))
    inside = members[0] @ members[1]
    assert ((found.low <= inside) & (inside <= found.high)).all()
    u, v = members[0][:, 0], members[0][:, 1]
    scalar, vector = (
        dot(around(A[:, 0], half), around(A[:, 1], half)),
        cross(around(A[:, 0], half), around(A[:, 1], half)),
    )
    assert ((scalar.low <= np.sum(u * v, -1)) & (np.sum(u * v, -1) <= scalar.high)).all()
    assert ((vector.low <= np.cross(u, v)) & (np.cross(u, v) <= vector.high)).all()


def test_intervals_with_a_singular_member_are_never_regular() -> None:
    rng = np.random.default_rng(5)
    singular = rng.normal(size=(200, 6, 6))
    singular[:, 5] = np.einsum("bk,bkj->bj", rng.normal(size=(200, 5)), singular[:, :5])
    away = 10.0 ** rng.uniform(-9, -1, (200, 1, 1)) * rng.uniform(-1, 1, singular.shape)
    assert not is_regular(around(singular + away, np.abs(away) * (1 + 1e-12))).any()


def test_narrow_intervals_of_regular_matrices_are_regular_also_with_more_rows_than_columns() -> None:
    rng = np.random.default_rng(6)
    for rows in (6, 8):
        A = rng.normal(size=(100, rows, 6))
        least = np.linalg.svd(A, compute_uv=False)[:, -1]
        assert is_regular(around(A, (0.02 * least)[:, None, None])).all()
        assert not is_regular(around(A, (2.0 * least)[:, None, None])).any()


def test_matrices_of_very_different_units_are_regular_all_the_same() -> None:
    rng = np.random.default_rng(7)
    A = rng.normal(size=(20, 6, 6))
    units = np.array([1.0, 1.0, 1.0, 1e-6, 1e-6, 1e-6])
    reach = 0.01 * np.linalg.svd(A, compute_uv=False)[:, -1, None, None] * units
    assert is_regular(around(A * units, reach)).all()


def test_unbounded_matrices_are_not_regular() -> None:
    assert not is_regular(hull(np.full((1, 3, 3), -np.inf), np.full((1, 3, 3), np.inf))).any()


def test_the_tangent_is_bounded_from_above_and_closely() -> None:
    for angle in np.linspace(1e-6, 1.9, 50):
        bound = tangent_of_half(float(angle))
        assert math.tan(angle / 2) <= bound <= 1.1 * math.tan(angle / 2)
