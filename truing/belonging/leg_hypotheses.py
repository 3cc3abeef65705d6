"""Hypotheses about how a legged mechanism, its poses and its actuator readings were written down."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truing.belonging.relation import LENGTH_FACTORS, Slip, SlipKind, both_ways
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import inverse

Array = NDArray[np.float64]

_STEP = 1e-30  # of the complex step: exact to rounding
_SMALL = 0.05  # relative; a length is another one beyond it (and beyond ten tolerances)
_TOLERANCES = 10.0
_AXES = "xyz"


@dataclass(frozen=True)
class Motion:
    """Measured poses of a platform with readings: p (B, 3) m, R (B, 3, 3), readings (B, L) m.

    ``tolerance``: one standard deviation of a, b, l (m) and u (1). ``noise``: one standard deviation of a reading less
    the one that the pose asks for, m. ``drivers`` (B, C): what else may drive the legs (time, temperature), each
    scaled to unit spread.
    """

    legs: Legs
    tolerance: dict[str, float]
    p: Array
    R: Array
    readings: Array
    noise: float
    drivers: Array

    def every(self, step: int) -> Motion:
        """Return the same of every ``step``-th pose."""
        thin = {name: getattr(self, name)[::step] for name in ("p", "R", "readings", "drivers")}
        return replace(self, **thin)

    def chosen(self, rows: NDArray[np.int64]) -> Motion:
        """Return the same of some poses."""
        part = {name: getattr(self, name)[rows] for name in ("p", "R", "readings", "drivers")}
        return replace(self, **part)

    def chosen_columns(self, legs: NDArray[np.int64]) -> Motion:
        """Return the same poses with the readings of some legs alone, for comparing numbers and not geometry."""
        return replace(self, readings=self.readings[:, legs])


@dataclass(frozen=True)
class Description:
    """A mechanism and poses as they may have been meant, and the slips that made them what is recorded."""

    slips: tuple[Slip, ...]
    legs: Legs
    p: Array
    R: Array

    def every(self, step: int) -> Description:
        """Return the same of every ``step``-th pose."""
        return Description(self.slips, self.legs, self.p[::step], self.R[::step])

    def asked(self) -> Array:
        """Return the readings (B, L), m, that the poses ask for; NaN where no leg reaches."""
        with np.errstate(invalid="ignore", over="ignore"):
            return np.asarray(inverse(self.legs, self.p, self.R).real, float)

    def by_geometry(self) -> Array:
        """Return the derivative (B, L, G) of the readings asked for by each number of a leg; a, b, l in m, u in 1."""
        columns = []
        for name, index in self._numbers():
            array = getattr(self.legs, name).astype(complex)
            array[(..., index) if index is not None else ...] += 1j * _STEP
            columns.append(inverse(self.legs.replace(**{name: array}), self.p, self.R).imag / _STEP)
        return np.stack(columns, -1)

    def scales(self, tolerance: dict[str, float]) -> Array:
        """Return the tolerance (G,) of each number, in the order of ``by_geometry``."""
        return np.array([tolerance[name] for name, _ in self._numbers()])

    def _numbers(self) -> Iterator[tuple[str, int | None]]:
        for name in self.legs.closure.geometry:
            yield from ((name, None),) if name == "l" else ((name, axis) for axis in range(3))


def descriptions(motion: Motion) -> Iterator[Description]:
    """Yield the mechanism and the poses as recorded first, then each with one slip undone."""
    legs, p, R = motion.legs, motion.p, motion.R
    yield Description((), legs, p, R)
    yield Description((Slip(SlipKind.PARTS_EXCHANGED, "joints of [mechanism]", ("a_mm", "b_mm")),), *_swapped(motion))
    if "u" in legs.closure.geometry:
        yield Description((Slip(SlipKind.DIRECTION, "u of [mechanism]"),), legs.replace(u=-legs.u), p, R)
    yield from _other_lengths(motion)
    for factor in both_ways(LENGTH_FACTORS):
        yield Description((_unit("a_mm and b_mm", factor),), legs.replace(a=factor * legs.a, b=factor * legs.b), p, R)
        whole = legs.replace(a=factor * legs.a, b=factor * legs.b, l=factor * legs.l, rho0=factor * legs.rho0)
        yield Description((_unit("all lengths of [mechanism]", factor),), whole, p, R)
        yield Description((_unit("points and survey", factor),), legs, factor * p, R)
    for axis, name in enumerate(_AXES):
        mirror = np.where(np.arange(3) == axis, -1.0, 1.0)
        slip = Slip(SlipKind.MIRRORED, "points and survey, or the joints of [mechanism],", (f"along {name}",))
        yield Description((slip,), legs, p * mirror, mirror[:, None] * R * mirror)
    back = np.swapaxes(R, -1, -2)
    slip = Slip(SlipKind.PARTS_EXCHANGED, "bodies", ("base", "platform"))
    yield Description((slip,), legs, -(back @ p[..., None])[..., 0], back)
    for shift in (1, -1):
        slip = Slip(SlipKind.COLUMNS, "b_mm of [mechanism] against a_mm", (f"legs moved on by {shift}",))
        yield Description((slip,), legs.replace(b=np.roll(legs.b, shift, axis=-2)), p, R)


def _unit(quantity: str, factor: float) -> Slip:
    return Slip(SlipKind.UNIT, quantity, (), factor)


def _swapped(motion: Motion) -> tuple[Legs, Array, Array]:
    legs = motion.legs
    return legs.replace(a=legs.b, b=legs.a), motion.p, motion.R


def _other_lengths(motion: Motion) -> Iterator[Description]:
    """The lengths that poses and readings ask for, where they are not those of the description."""
    legs = motion.legs
    if "l" not in legs.closure.geometry:
        return
    upper = motion.p[..., None, :] + legs.b @ np.swapaxes(motion.R, -1, -2)
    gap = np.linalg.norm(upper - legs.closure.lower(legs, motion.readings), axis=-1)
    with np.errstate(invalid="ignore"):
        meant = legs.l + np.nanmedian(gap - legs.closure.length(legs, motion.readings), axis=0)
    off = np.abs(meant - legs.l) > np.maximum(_SMALL * legs.l, _TOLERANCES * motion.tolerance["l"])
    off &= np.isfinite(meant) & (meant > 0.0)
    if not off.any():
        return
    length = np.where(off, meant, legs.l)
    ratio = length[off] / legs.l[off]
    names = tuple(f"leg {leg + 1}" for leg in np.flatnonzero(off))
    if off.all() and np.ptp(ratio) < _SMALL * ratio.mean():
        slips: tuple[Slip, ...] = (_unit("length_mm", _round(float(np.median(ratio)))),)
    else:
        slips = tuple(
            Slip(SlipKind.UNIT, "length_mm of", (name,), _round(float(one)))
            for name, one in zip(names, ratio, strict=True)
        )
    yield Description(slips, legs.replace(l=length), motion.p, motion.R)


def _round(factor: float) -> float:
    """A factor between units where it is near to one, else three digits."""
    known = np.array([*both_ways(LENGTH_FACTORS), 0.5, 2.0])
    nearest = float(known[np.argmin(np.abs(np.log(factor / known)))])
    return nearest if abs(np.log(factor / nearest)) < _SMALL else float(f"{factor:.3g}")
