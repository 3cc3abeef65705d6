"""Rotations as numbers of a table, and the slips in how they were written or read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from truing.arrays import Array, Index, Mask
from truing.belonging.relation import RecordSlip, RotationForm, SlipKind

_TURNS = [axes for axes in product("XYZ", repeat=3) if axes[0] != axes[1] != axes[2]]
ORDERS = tuple("".join(axes) for axes in _TURNS) + tuple("".join(axes).lower() for axes in _TURNS)
"""Orders of Euler angles, about turned axes (capitals) and fixed ones: three axes, or the first one again."""
MEASURED = "measured orientations"
INVERTED = (RotationForm.INVERSE, RotationForm.INVERSION)
_GON = 0.9
# Recorded angles times these are right.
_UNITS_OF_EULER = (180.0 / np.pi, np.pi / 180.0, _GON, 1.0 / _GON)
_UNITS_OF_VECTORS = (180.0 / np.pi, np.pi / 180.0)
_READ = 1e-4  # rad: recorded angles give the rotations to rounding
_LETTERS, _COMPONENTS = ("a", "b", "c"), ("x", "y", "z")


@dataclass(frozen=True)
class WrittenRotations:
    """Rotations R (B, 3, 3) as read, and the numbers (B, 3), rad, that they were read from.

    ``angles`` are Euler angles in the order ``euler``, or rotation vectors where that is None; they are None for
    quaternions and matrices, and where they are not known.
    """

    R: NDArray
    euler: str | None = None
    angles: NDArray | None = None

    @classmethod
    def of_table(cls, R: NDArray, euler: str | None, angles: NDArray | None) -> WrittenRotations:
        """Return the rotations with those of the declared notations that give them."""
        if angles is None or not np.isfinite(angles).all():
            return cls(R, euler)
        for order in (euler, None):
            read = Rotation.from_euler(order, angles) if order else Rotation.from_rotvec(angles)
            if float(np.median((read.inv() * Rotation.from_matrix(R)).magnitude())) < _READ:
                return cls(R, order, angles)
        return cls(R, euler)

    def subset(self, rows: Index | Mask) -> WrittenRotations:
        """Return some of the rotations."""
        return replace(self, R=self.R[rows], angles=None if self.angles is None else self.angles[rows])

    @property
    def numbers(self) -> Array:
        """Angles (B, 3), rad, as recorded, or else as they may have been."""
        if self.angles is not None:
            return np.asarray(self.angles)
        read = Rotation.from_matrix(self.R)
        return np.asarray(read.as_rotvec() if self.euler is None else read.as_euler(self.euler))

    def read(self, numbers: NDArray) -> Array:
        """Return rotations (B, 3, 3) of other numbers in the same notation."""
        if self.euler is None:
            return np.asarray(Rotation.from_rotvec(numbers).as_matrix())
        return np.asarray(Rotation.from_euler(self.euler, numbers).as_matrix())


def otherwise_written(written: WrittenRotations) -> Iterator[tuple[RecordSlip, Array]]:
    """Yield slips in all rotations, with the rotations (B, 3, 3) without them.

    A slip that reverses an odd number of components of the quaternion, or exchanges two, is an orthogonal map of four
    dimensions with determinant -1. That is an inversion between two constant rotations, and an unknown base and tool
    take these up. So the scalar at the other end, and rotation vectors with two components exchanged or one reversed,
    are no trials of their own. Mirrored axes are no inversion, and cannot be seen at all.
    """
    yield (
        rotation_slip(RotationForm.INVERSION if written.euler is None else RotationForm.INVERSE),
        np.swapaxes(written.R, -1, -2),
    )
    yield from _in_other_orders(written)
    if written.angles is not None:
        yield from _in_other_units(written)
        if written.euler is not None:
            yield from _with_other_angles(written)


def written_otherwise_in_part(written: WrittenRotations) -> Iterator[tuple[RecordSlip, Array]]:
    """Yield slips in some rotations, with all rotations (B, 3, 3) without them; base and tool are known from others, so
    that no two slips are equal."""
    yield rotation_slip(RotationForm.INVERSE), np.swapaxes(written.R, -1, -2)
    yield from _in_other_orders(written)
    if written.angles is not None:
        yield from _in_other_units(written)
    if written.euler is not None:
        yield from _with_other_angles(written)
    elif written.angles is not None:
        yield from _with_other_components(written)
    else:
        yield from _with_other_quaternions(written)


def _in_other_orders(written: WrittenRotations) -> Iterator[tuple[RecordSlip, Array]]:
    numbers = written.numbers
    for order in ORDERS:
        if order != written.euler:
            yield rotation_slip(RotationForm.EULER, order), Rotation.from_euler(order, numbers).as_matrix()


def _in_other_units(written: WrittenRotations) -> Iterator[tuple[RecordSlip, Array]]:
    numbers = written.numbers
    for factor in _UNITS_OF_VECTORS if written.euler is None else _UNITS_OF_EULER:
        yield RecordSlip(SlipKind.UNIT, MEASURED, factor=factor, dimension="angle"), written.read(factor * numbers)


def _with_other_angles(written: WrittenRotations) -> Iterator[tuple[RecordSlip, Array]]:
    """Yield Euler angles with an opposite sign or in each other's columns, and rotation vectors in place of them."""
    numbers = written.numbers
    for letter, signs in zip(_LETTERS, 1.0 - 2.0 * np.eye(3), strict=True):
        yield RecordSlip(SlipKind.SIGN, f"angle {letter} of {MEASURED}"), written.read(signs * numbers)
    yield from _permuted(written, "angles", _LETTERS)
    yield rotation_slip(RotationForm.VECTOR), Rotation.from_rotvec(numbers).as_matrix()


def _with_other_components(written: WrittenRotations) -> Iterator[tuple[RecordSlip, Array]]:
    """Yield rotation vectors with opposite signs, or with exchanged components."""
    numbers = written.numbers
    for changed in ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2)):
        signs = np.where(np.isin(np.arange(3), changed), -1.0, 1.0)
        names = " and ".join(_COMPONENTS[k] for k in changed)
        yield RecordSlip(SlipKind.SIGN, f"{names} of {MEASURED}"), written.read(signs * numbers)
    yield from _permuted(written, "components", _COMPONENTS)


def _permuted(written: WrittenRotations, what: str, names: tuple[str, ...]) -> Iterator[tuple[RecordSlip, Array]]:
    for order in permutations(range(3)):
        moved = tuple(names[k] for k in range(3) if order[k] != k)
        if moved:
            slip = RecordSlip(SlipKind.COLUMNS, f"{what} of {MEASURED}", moved)
            yield slip, written.read(written.numbers[:, list(order)])


def _with_other_quaternions(written: WrittenRotations) -> Iterator[tuple[RecordSlip, Array]]:
    """Yield quaternions with the scalar at the other end, an opposite sign, or two exchanged components."""
    q = Rotation.from_matrix(written.R).as_quat()
    for shift in (1, -1):
        yield rotation_slip(RotationForm.SCALAR_AT_OTHER_END), Rotation.from_quat(np.roll(q, shift, axis=1)).as_matrix()
    for k, name in enumerate(_COMPONENTS):
        signs = np.where(np.arange(4) == k, -1.0, 1.0)
        yield RecordSlip(SlipKind.SIGN, f"{name} of {MEASURED}"), Rotation.from_quat(signs * q).as_matrix()
    for i, j in combinations(range(3), 2):
        order = np.arange(4)
        order[[i, j]] = j, i
        slip = RecordSlip(SlipKind.COLUMNS, f"components of {MEASURED}", (_COMPONENTS[i], _COMPONENTS[j]))
        yield slip, Rotation.from_quat(q[:, order]).as_matrix()


def rotation_slip(form: RotationForm, order: str = "", quantity: str = MEASURED) -> RecordSlip:
    """Return the slip of rotations that were written in another form, with the order of its angles or axes."""
    named = {RotationForm.EULER: order, RotationForm.AXES: f"components {order}"}.get(form, form.value)
    return RecordSlip(SlipKind.ROTATION, quantity, (named,), form=form, order=order)
