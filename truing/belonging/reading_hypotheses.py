"""Hypotheses about the recording of a legged mechanism, its poses and its readings, and their evidence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations, product

import numpy as np
from scipy.special import gammaln

from truing.arrays import Array, Index, Mask
from truing.belonging.assignment import cheapest_columns
from truing.belonging.evidence import Physics, log_evidence, physics_of_each
from truing.belonging.relation import LENGTH_FACTORS, RecordSlip, SlipKind, both_ways
from truing.belonging.rotation_writing import WrittenRotations, otherwise_written
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import inverse

_STEP = 1e-30  # complex step: derivatives are exact to rounding
_SMALL = 0.05  # relative difference (and ten tolerances) beyond which a length is another one
_TOLERANCES = 10.0
_AXES = "xyz"
# Standard deviations of physical effects on a reading, which need no slip as explanation.
_GAIN = 0.1  # per leg's own travel
_LEAK = 0.05  # per other leg's travel: deformation of platform and base
_CURVED = 0.05  # per own travel, quadratic
_DRIVEN_M = 5e-5  # by time, temperature and other recorded drivers, over their spread
PENALTY = 15.0  # log prior odds against a slip
_GROSS = 0.05  # share of a leg's length
# Least standard deviation of a joint or a length, relative to a leg's length: a declared tolerance may be ten times too
# small.
_LOOSE = 0.01
_STANDS_STILL = 0.01  # way of the base relative to that of the platform
_UNREACHED = 0.1  # share of the readings that poses require


@dataclass(frozen=True)
class MeasuredMotion:
    """Measured poses of a platform with readings: p (B, 3) m, R (B, 3, 3), readings (B, L) m.

    ``tolerance``: one standard deviation of a, b, l (m) and u (1). ``noise``: one standard deviation of a reading minus
    the one required by the pose, m. ``drivers`` (B, C): other possible inputs (time, temperature), each scaled to unit
    spread. ``measured``: what the poses come from, in words. ``base``: places (B, 3) and rotations (B, 3, 3) of the
    base in the frame of the measurement; None where these, or poses before and after each, are not known.
    ``were_rotations_written``: R comes from numbers of a table, read as Euler angles in the order ``euler``, or as
    rotation vectors or quaternions if it is None. ``time_s`` (B,): None where no times were recorded.
    """

    legs: Legs
    tolerance: dict[str, float]
    p: Array
    R: Array
    readings: Array
    noise: float
    drivers: Array
    measured: str = "points and survey"
    base: tuple[Array, Array] | None = None
    were_rotations_written: bool = False
    euler: str | None = None
    time_s: Array | None = None

    def every_nth(self, step: int) -> MeasuredMotion:
        """Return every ``step``-th pose."""
        thin = {name: getattr(self, name)[::step] for name in ("p", "R", "readings", "drivers")}
        return replace(self, **thin, base=None, time_s=None)

    def subset(self, rows: Index) -> MeasuredMotion:
        """Return some of the poses."""
        part = {name: getattr(self, name)[rows] for name in ("p", "R", "readings", "drivers")}
        return replace(self, **part, base=None, time_s=None)

    def chosen_columns(self, legs: Index) -> MeasuredMotion:
        """Return the same poses with the readings of some legs alone, for comparisons of numbers without geometry."""
        return replace(self, readings=self.readings[:, legs])


@dataclass(frozen=True)
class Description:
    """A mechanism and poses as possibly intended, and the slips that changed them to the recorded ones."""

    slips: tuple[RecordSlip, ...]
    legs: Legs
    p: Array
    R: Array

    def every_nth(self, step: int) -> Description:
        """Return the same with every ``step``-th pose."""
        return Description(self.slips, self.legs, self.p[::step], self.R[::step])

    def required_readings(self) -> Array:
        """Return the readings (B, L), m, required by the poses; NaN where no leg reaches."""
        with np.errstate(invalid="ignore", over="ignore"):
            return np.asarray(inverse(self.legs, self.p, self.R).real, float)

    def by_geometry(self) -> Array:
        """Return the derivative (B, L, G) of the required readings by each parameter of a leg; a, b, l in m, u in 1."""
        columns = []
        for name in self.legs.closure.geometry:
            array = getattr(self.legs, name).astype(complex)[None]
            if name != "l":  # one axis after the other, in a batch
                array = array[:, None] + 1j * _STEP * np.eye(3)[:, None, None]
            else:
                array = array + 1j * _STEP
            columns += list(inverse(self.legs.replace(**{name: array}), self.p, self.R).imag.reshape(-1, *self._size))
        return np.stack(columns, -1) / _STEP

    @property
    def _size(self) -> tuple[int, int]:
        return len(self.p), self.legs.count

    def scales(self, tolerance: dict[str, float]) -> Array:
        """Return the tolerance (G,) of each parameter, in the order of ``by_geometry``."""
        return np.array([tolerance[name] for name, _ in self._numbers()])

    def _numbers(self) -> Iterator[tuple[str, int | None]]:
        for name in self.legs.closure.geometry:
            yield from ((name, None),) if name == "l" else ((name, axis) for axis in range(3))


def descriptions(motion: MeasuredMotion) -> Iterator[Description]:
    """Yield the mechanism and the poses as recorded, then each with one slip undone."""
    legs, p, R = motion.legs, motion.p, motion.R
    yield Description((), legs, p, R)
    slip = RecordSlip(SlipKind.PARTS_EXCHANGED, "joints of [mechanism]", ("a_mm", "b_mm"))
    yield Description((slip,), legs.replace(a=legs.b, b=legs.a), p, R)
    if "u" in legs.closure.geometry:
        yield Description((RecordSlip(SlipKind.DIRECTION, "u of [mechanism]"),), legs.replace(u=-legs.u), p, R)
    yield from _other_lengths(motion)
    for factor in both_ways(LENGTH_FACTORS):
        yield Description((_unit("a_mm and b_mm", factor),), legs.replace(a=factor * legs.a, b=factor * legs.b), p, R)
        scaled = legs.replace(a=factor * legs.a, b=factor * legs.b, l=factor * legs.l, rho0=factor * legs.rho0)
        yield Description((_unit("all lengths of [mechanism]", factor),), scaled, p, R)
        yield Description((_unit(motion.measured, factor),), legs, factor * p, R)
    for axis, name in enumerate(_AXES):
        mirror = np.where(np.arange(3) == axis, -1.0, 1.0)
        slip = RecordSlip(SlipKind.MIRRORED, f"{motion.measured}, or the joints of [mechanism],", (f"along {name}",))
        yield Description((slip,), legs, p * mirror, mirror[:, None] * R * mirror)
    yield from _shifted_bodies(motion)
    yield from _other_rotations(motion)
    back = np.swapaxes(R, -1, -2)
    slip = RecordSlip(SlipKind.PARTS_EXCHANGED, "bodies", ("base", "platform"))
    yield Description((slip,), legs, -(back @ p[..., None])[..., 0], back)
    for shift in (1, -1):
        slip = RecordSlip(SlipKind.COLUMNS, "b_mm of [mechanism] against a_mm", (f"legs moved on by {shift}",))
        yield Description((slip,), legs.replace(b=np.roll(legs.b, shift, axis=-2)), p, R)


def _shifted_bodies(motion: MeasuredMotion) -> Iterator[Description]:
    """Yield the poses with the measurements of one body from the row before or after.

    The last row, which has no such neighbour, gets the pose of the neighbouring row. Where the base stands still in the
    measurements, rows of the platform are as good as rows of readings, and only the latter are tried.
    """
    if motion.base is None or len(motion.p) < 2:
        return
    t, base = motion.base
    if np.linalg.norm(t - t.mean(axis=0)) < _STANDS_STILL * np.linalg.norm(motion.p - motion.p.mean(axis=0)):
        return
    position, turned = t + (base @ motion.p[..., None])[..., 0], base @ motion.R
    for body, shift in product(("platform", "base"), (1, -1)):
        rows = np.clip(np.arange(len(motion.p)), max(0, -shift), len(motion.p) - 1 - max(0, shift))
        moved = rows + shift
        of_base, of_platform = (rows, moved) if body == "platform" else (moved, rows)
        back = np.swapaxes(base[of_base], -1, -2)
        p = (back @ (position[of_platform] - t[of_base])[..., None])[..., 0]
        slip = RecordSlip(SlipKind.ROWS_SHIFTED, f"measurements of {body}", shift=shift)
        yield Description((slip,), motion.legs, p, back @ turned[of_platform])


def _other_rotations(motion: MeasuredMotion) -> Iterator[Description]:
    """Yield the poses with both rotations read otherwise: as Euler angles in another order, or inverse."""
    if motion.base is None or not motion.were_rotations_written:
        return
    (t, base), count = motion.base, len(motion.p)
    position, turned = t + (base @ motion.p[..., None])[..., 0], base @ motion.R
    for slip, read in otherwise_written(WrittenRotations(np.concatenate([base, turned]), motion.euler)):
        back = np.swapaxes(read[:count], -1, -2)
        yield Description((slip,), motion.legs, (back @ (position - t)[..., None])[..., 0], back @ read[count:])


def joint_descriptions(motion: MeasuredMotion) -> Iterator[Description]:
    """Yield the mechanism with one slip undone in the joints of one leg, of two legs, or of one side.

    These are too many to be tried where readings and poses agree.
    """
    legs, p, R = motion.legs, motion.p, motion.R
    sides = {"a_mm": legs.a, "b_mm": legs.b}

    def described(slip: RecordSlip, **changed: Array) -> Description:
        return Description((slip,), legs.replace(**{name[0]: array for name, array in changed.items()}), p, R)

    for name, joints in sides.items():
        quantity_text = f"{name} of [mechanism]"
        for factor in (*both_ways(LENGTH_FACTORS), 2.0, 0.5):
            yield described(_unit(quantity_text, factor), **{name: factor * joints})
        for axis in range(3):
            if np.any(joints[:, axis] != 0.0):
                mirror = np.where(np.arange(3) == axis, -1.0, 1.0)
                yield described(
                    RecordSlip(SlipKind.SIGN, f"{_AXES[axis]} of {quantity_text}"), **{name: joints * mirror}
                )
        yield described(RecordSlip(SlipKind.REVERSED, f"rows of {quantity_text}"), **{name: joints[::-1]})
        for first, other in combinations(range(legs.count), 2):
            order = np.arange(legs.count)
            order[[first, other]] = other, first
            slip = RecordSlip(SlipKind.PARTS_EXCHANGED, quantity_text, _legs_named((first, other)))
            yield described(slip, **{name: joints[order]})
    for leg, axis in product(range(legs.count), range(3)):
        flipped = {}
        for name, joints in sides.items():
            if joints[leg, axis] != 0.0:
                flipped[name] = joints.copy()
                flipped[name][leg, axis] *= -1.0
        for name, joints in flipped.items():
            slip = RecordSlip(SlipKind.SIGN, f"{_AXES[axis]} of {name} of", _legs_named((leg,)))
            yield described(slip, **{name: joints})
        if len(flipped) > 1:
            slip = RecordSlip(SlipKind.SIGN, f"{_AXES[axis]} of a_mm and b_mm of", _legs_named((leg,)))
            yield described(slip, **flipped)


def _legs_named(legs: tuple[int, ...]) -> tuple[str, ...]:
    return tuple(f"leg {leg + 1}" for leg in legs)


def _unit(quantity: str, factor: float) -> RecordSlip:
    return RecordSlip(SlipKind.UNIT, quantity, (), factor)


def _other_lengths(motion: MeasuredMotion) -> Iterator[Description]:
    """Return the lengths that poses and readings require, if they differ from those of the description."""
    legs = motion.legs
    if "l" not in legs.closure.geometry:
        return
    upper = motion.p[..., None, :] + legs.b @ np.swapaxes(motion.R, -1, -2)
    gap = np.linalg.norm(upper - legs.closure.lower(legs, motion.readings), axis=-1)
    with np.errstate(invalid="ignore"):
        intended = legs.l + np.nanmedian(gap - legs.closure.length(legs, motion.readings), axis=0)
    off = np.abs(intended - legs.l) > np.maximum(_SMALL * legs.l, _TOLERANCES * motion.tolerance["l"])
    off &= np.isfinite(intended) & (intended > 0.0)
    if not off.any():
        return
    length = np.where(off, intended, legs.l)
    ratio = length[off] / legs.l[off]
    names = tuple(f"leg {leg + 1}" for leg in np.flatnonzero(off))
    if off.all() and np.ptp(ratio) < _SMALL * ratio.mean():
        slips: tuple[RecordSlip, ...] = (_unit("length_mm", _round(float(np.median(ratio)))),)
    else:
        slips = tuple(
            RecordSlip(SlipKind.UNIT, "length_mm of", (name,), _round(float(one)))
            for name, one in zip(names, ratio, strict=True)
        )
    yield Description(slips, legs.replace(l=length), motion.p, motion.R)


def _round(factor: float) -> float:
    """Return the nearest factor between units, or else three digits."""
    known = np.array([*both_ways(LENGTH_FACTORS), 0.5, 2.0])
    nearest = float(known[np.argmin(np.abs(np.log(factor / known)))])
    return nearest if abs(np.log(factor / nearest)) < _SMALL else float(f"{factor:.3g}")


@dataclass(frozen=True)
class ReadingChange:
    """Change of the readings of one leg: multiplied by ``factor``, with the recorded zero or another one."""

    factor: float
    zero: bool

    @property
    def penalty(self) -> float:
        """Log prior odds against the change."""
        return PENALTY * ((abs(self.factor) != 1.0) + (self.factor < 0.0) + self.zero)


@dataclass(frozen=True)
class RecordingHypothesis:
    """A hypothesis on recorded readings: for each leg its column and change, with the evidence."""

    description: Description
    columns: Index
    changes: tuple[ReadingChange, ...]
    evidence: float
    misfit: Array  # (B, L) m, readings as meant less those that the poses ask for

    def readings(self, recorded: Array, required: Array) -> Array:
        """Return the readings (B, L) as intended."""
        intended = self.undone(recorded)
        zero = np.array([change.zero for change in self.changes])
        if not zero.any():
            return intended
        offset = required - intended
        median = np.nanmedian if np.isnan(offset).any() else np.median  # the former takes ten times as long
        return intended + np.where(zero, median(offset, axis=0), 0.0)

    def undone(self, recorded: Array) -> Array:
        """Return the readings (B, L) in the right columns, unit and sign, with the recorded zero."""
        return np.asarray(recorded[:, self.columns] * np.array([change.factor for change in self.changes]))

    def slips(self, names: tuple[str, ...], recorded: Array) -> tuple[RecordSlip, ...]:
        """Return the slips from intended to recorded readings and description; none where all is right as recorded."""
        offset = self.misfit.mean(axis=0) + np.mean(finite_required_readings(self.description), axis=0)
        offset -= np.array([change.factor for change in self.changes]) * recorded[:, self.columns].mean(axis=0)
        changed = _change_slips(self, names, 1e3 * offset)
        return (*self.description.slips, *_column_slips(self.columns, names), *changed)


@cache
def leg_changes() -> tuple[ReadingChange, ...]:
    """Return the changes that are tried on each leg; the first is none."""
    factors = (1.0, *both_ways(LENGTH_FACTORS))
    return tuple(
        ReadingChange(sign * factor, zero) for zero in (False, True) for sign in (1.0, -1.0) for factor in factors
    )


def best_recording(
    motion: MeasuredMotion, description: Description, *, exchanged: bool
) -> tuple[RecordingHypothesis, RecordingHypothesis, int]:
    """Return the readings as recorded, the most likely intended ones under a description, and the number of trials.

    ``exchanged``: whether exchanged columns are tried as well.
    """
    required = finite_required_readings(description)
    changes = _with_fitted(leg_changes(), motion, required)
    count = required.shape[1]
    effects = physical_effects(motion, description, required)
    source = range(count)
    scores = np.full((count, count, len(changes)), -np.inf)
    # relative to the readings as recorded, so that a factor that shrinks them does not raise the evidence
    shrunk = len(required) * np.log(np.abs([change.factor for change in changes]))
    changed = _Changed(motion, required, changes)
    for leg in range(count):
        for column in source if exchanged else (leg,):
            misfit, is_geometry = changed.misfits(column, leg)
            scores[leg, column] = log_evidence(misfit, effects[leg], motion.noise) + shrunk
            scores[leg, column, is_geometry] = -np.inf
    if description.slips and np.isnan(description.required_readings()).mean() > _UNREACHED:
        scores[:] = -np.inf  # a description with poses out of reach explains nothing
    index = np.arange(count)
    plain = _hypothesis(
        motion, description, required, index, [changes[0]] * count, float(scores[index, index, 0].sum())
    )
    found = _most_likely(scores, changes, exchanged=exchanged)
    best = _hypothesis(motion, description, required, found[0], [changes[k] for k in found[1]], found[2])
    # the fitted factor is none of those that are tried in every campaign
    return plain, best, count * (count if exchanged else 1) * len(leg_changes())


def finite_required_readings(description: Description) -> Array:
    """Return the readings (B, L), m, required by the poses; a far-off value where no leg reaches."""
    required = description.required_readings()
    far = np.broadcast_to(np.abs(description.legs.l) + np.abs(description.legs.rho0), required.shape)
    return np.where(np.isfinite(required), required, 2.0 * far + 1.0)


def _with_fitted(
    changes: tuple[ReadingChange, ...], motion: MeasuredMotion, required: Array
) -> tuple[ReadingChange, ...]:
    """Return the changes, and the one common factor that explains most if it is none of them."""
    read, wanted = (values - values.mean(axis=0) for values in (motion.readings, required))
    square = float(np.sum(read**2))
    slope = float(np.sum(read * wanted)) / square if square > 0.0 else 0.0
    known = np.array([abs(change.factor) for change in changes])
    if slope == 0.0 or np.abs(np.log(abs(slope) / known)).min() < 3.0 * _GAIN:
        return changes
    return (*changes, *(ReadingChange(float(f"{slope:.4g}"), zero) for zero in (False, True)))


def physical_effects(
    motion: MeasuredMotion, description: Description, required: Array, movement: Array | None = None
) -> list[Physics]:
    """Return the physical effects on each leg's readings: geometry, travel of all legs, and recorded drivers.

    ``movement`` (B, L, C): further columns of each leg.
    """
    least = _LOOSE * float(np.abs(motion.legs.l).mean())
    loose = {name: max(sigma, _LOOSE if name == "u" else least) for name, sigma in motion.tolerance.items()}
    geometry = np.nan_to_num(description.by_geometry()) * description.scales(loose)
    travel = required - required.mean(axis=0)
    widest = np.maximum(np.abs(travel).max(axis=0), 1e-12)
    effects = []
    for leg in range(required.shape[1]):
        reach = travel * np.where(np.arange(required.shape[1]) == leg, _GAIN, _LEAK)
        curved = _CURVED * travel[:, leg, None] ** 2 / widest[leg]
        following = [] if movement is None else [_DRIVEN_M * movement[:, leg]]
        effects.append(np.hstack([geometry[:, leg], reach, curved, _DRIVEN_M * motion.drivers, *following]))
    return physics_of_each(np.stack(effects))


@dataclass(frozen=True)
class _Changed:
    """Readings of a motion changed in T ways, against the required ones (B, L)."""

    motion: MeasuredMotion
    required: Array
    changes: tuple[ReadingChange, ...]

    @cached_property
    def _factor(self) -> Array:
        return np.array([change.factor for change in self.changes])

    @cached_property
    def _zero(self) -> Index:
        return np.flatnonzero([change.zero for change in self.changes])

    @cached_property
    def _longest(self) -> float:
        return float(np.abs(self.motion.legs.l).max())

    def misfits(self, column: int, leg: int) -> tuple[Array, Mask]:
        """Return the readings of a column less those required of a leg, (T, B); and True for changes (T,) that are only
        a shift of zero of a size that errors of the geometry can cause."""
        misfit = self._factor[:, None] * self.motion.readings[:, column] - self.required[:, leg]
        offset = np.median(misfit[self._zero], axis=1)
        misfit[self._zero] -= offset[:, None]
        is_geometry = np.zeros(len(self.changes), bool)
        is_geometry[self._zero] = (np.abs(self._factor[self._zero]) == 1.0) & (np.abs(offset) < _GROSS * self._longest)
        return misfit, is_geometry


def _most_likely(
    scores: Array, changes: tuple[ReadingChange, ...], *, exchanged: bool
) -> tuple[Index, list[int], float]:
    """Return columns (L,), change per leg, and evidence less penalties: one change for all legs, or one per leg."""
    count = len(scores)
    penalty = np.array([change.penalty for change in changes])
    exchange = PENALTY + float(gammaln(count + 1.0))  # log of the number of orders
    # all legs changed alike, with one penalty, or each by itself, with one penalty per leg
    alone = scores - np.log(count) * (penalty > 0.0) - penalty
    index = np.arange(count)
    best: tuple[Index, list[int], float] = (index, [0] * count, -np.inf)
    alike = (scores[index, index] - penalty / count).sum(axis=0)
    # Without exchanges only the best change for all legs can win.
    tried = range(len(changes)) if exchanged else (int(np.argmax(alike)),)
    ways = [(scores[:, :, change] - penalty[change] / count, change) for change in tried]
    for value, common in (*ways, (alone.max(axis=2), None)):
        for is_moved in (False, True) if exchanged else (False,):
            # No order of columns can be better than the best column of each leg.
            if is_moved and float(value.max(axis=1).sum()) - exchange <= best[2]:
                continue
            columns = _assigned(value) if is_moved else index
            total = float(value[index, columns].sum()) - exchange * bool((columns != index).any())
            if total > best[2]:
                chosen = alone[index, columns].argmax(axis=1).tolist() if common is None else [common] * count
                best = columns, chosen, total
    return best


def _assigned(value: Array) -> Index:
    """Return the column (L,) of each leg that maximises the sum of values."""
    return cheapest_columns(np.where(np.isfinite(value), -value, 1e30))


def _hypothesis(
    motion: MeasuredMotion,
    description: Description,
    required: Array,
    columns: Index,
    changes: list[ReadingChange],
    evidence: float,
) -> RecordingHypothesis:
    intended = RecordingHypothesis(description, columns, tuple(changes), evidence, np.empty(0))
    misfit = intended.readings(motion.readings, required) - required
    return RecordingHypothesis(
        description, columns, tuple(changes), evidence - PENALTY * len(description.slips), misfit
    )


def _column_slips(columns: Index, names: tuple[str, ...]) -> tuple[RecordSlip, ...]:
    moved = np.flatnonzero(columns != np.arange(len(columns)))
    if not len(moved):
        return ()
    subjects = tuple(f"{names[leg]} holds {names[np.flatnonzero(columns == leg)[0]]}" for leg in moved)
    if len(moved) == 2:
        subjects = tuple(names[leg] for leg in moved)
    return (RecordSlip(SlipKind.COLUMNS, "columns of readings (or legs of [mechanism])", subjects),)


def _change_slips(hypothesis: RecordingHypothesis, names: tuple[str, ...], offset_mm: Array) -> tuple[RecordSlip, ...]:
    """Return changes of readings by kind; columns with the same change are one slip."""
    legs_of_slip: dict[tuple[SlipKind, float], list[int]] = {}
    for leg, change in enumerate(hypothesis.changes):
        if abs(change.factor) != 1.0:
            legs_of_slip.setdefault((SlipKind.UNIT, abs(change.factor)), []).append(leg)
        if change.factor < 0.0:
            legs_of_slip.setdefault((SlipKind.SIGN, 1.0), []).append(leg)
        if change.zero:
            legs_of_slip.setdefault((SlipKind.ZERO, 1.0), []).append(leg)
    slips = []
    for (kind, factor), legs in legs_of_slip.items():
        subjects = () if len(legs) == len(names) else tuple(sorted(names[hypothesis.columns[leg]] for leg in legs))
        offset = float(np.median(offset_mm[legs])) if kind is SlipKind.ZERO else 0.0
        slips.append(RecordSlip(kind, "readings", subjects, factor, offset=offset))
    return tuple(slips)
