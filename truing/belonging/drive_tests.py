"""Test of the readings of a drive against the measured rotation of a body that follows it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array, Mask
from truing.belonging.relation import RecordSlip, RelationState, RelationTest, SlipKind
from truing.belonging.slips_in_rows import row_places
from truing.estimation.rotation import log_so3

DRIVES = "drives-against-poses"
_FEWEST_POSES, _FEWEST_READINGS = 6, 4
_FOLLOW = 0.4  # least share of the poses that follow the drive: so many do not by chance, at four readings or more
_NEAR = 0.01  # largest departure of a pose that follows, over the range of the rotation
_LEAST_RANGE_DEG = 2.0  # of the rotation: smaller ones are no motion of a drive
_CLEAR = 0.2  # least rotation that shows its axis, over the largest
_REFERENCES = 5  # poses that are tried as the reference
_NEARLY_ALL = 0.9  # share of the poses; if fewer follow, a shift of all rows is more likely than single slips
_PAIR = 2
_SHIFTS = (1, -1, 2, -2, 3, -3)
_RADIANS = float(np.rad2deg(1.0))
_FACTORS = (1.0, _RADIANS, 1.0 / _RADIANS)


@dataclass(frozen=True)
class DrivenBody:
    """A body with its measured rotations (B, 3, 3), the readings (B,) of a drive in degrees, and names of the
    poses.

    ``mirrored``: changes of axes with the rotations (B, 3, 3) that the points show after each, for a flat body, which
    is its own mirror image.
    """

    body: str
    column: str
    rotations: Array
    readings: Array
    poses: Sequence[str]
    groups: Sequence[tuple[str, Sequence[str]]] = ()
    mirrored: Sequence[tuple[RecordSlip, Array]] = ()

    def shifted(self, shift: int) -> DrivenBody:
        """Return the body with each pose's reading taken ``shift`` rows further down, without poses that have none."""
        rows = np.arange(max(-shift, 0), len(self.readings) - max(shift, 0))
        names = tuple(self.poses[row] for row in rows.tolist())
        return replace(self, rotations=self.rotations[rows], readings=self.readings[rows + shift], poses=names)


@dataclass(frozen=True)
class _FollowedDrive:
    """A body's rotation as its readings times a factor, with either sign.

    ``expected`` (B,): readings that the rotations require; ``departure`` (B,) from these, with rotation about other
    axes, and the largest one of a pose that follows, all in degrees of rotation.
    """

    factor: float
    expected: Array
    departure: Array
    limit: float

    @property
    def follows(self) -> Mask:
        """True for poses (B,) that follow the drive."""
        return np.asarray(self.departure <= self.limit)

    @property
    def rms(self) -> float:
        """Root mean square departure, in degrees."""
        return float(np.sqrt(np.mean(self.departure**2)))


def relate_drive(driven: Sequence[DrivenBody]) -> RelationTest:
    """Return the test of a drive's readings against the body that follows them best.

    Not tested where no body rotates about one axis by the angle of the drive in most poses: bodies need not follow.
    """
    tested = [relation_test for body in driven if (relation_test := _relation(body)) is not None]
    if not tested:
        return RelationTest(DRIVES, RelationState.NOT_TESTED, "no-follower")
    return min(tested, key=lambda test: (test.state == RelationState.FAILS, test.misfit or 0.0))


def _relation(body: DrivenBody) -> RelationTest | None:
    """Return the test of one body; None if it follows the drive neither as recorded nor with rows shifted."""
    line, shift = _best_line(body), _shift(body)
    if line is None and shift is None:
        return None
    tested = RelationTest(DRIVES, RelationState.OK, "agrees", body.body, unit="deg", tried=3 + len(_SHIFTS))
    if line is None or (shift is not None and line.follows.mean() < _NEARLY_ALL):
        return replace(tested, state=RelationState.FAILS, reason="slip", slips=(shift,) if shift else ())
    tested = replace(tested, misfit=line.rms, limit=line.limit)
    if line.factor != 1.0:
        slip = RecordSlip(SlipKind.UNIT, body.column, (), line.factor, dimension="angle")
        return replace(tested, state=RelationState.FAILS, reason="slip", slips=(slip,))
    if line.follows.all():
        return tested
    rivals = () if shift is None else (shift,)
    return replace(tested, state=RelationState.FAILS, reason="slip", slips=(_slip(body, line),), rivals=rivals)


def _best_line(body: DrivenBody) -> _FollowedDrive | None:
    """Return the relation that most poses follow, over reference poses and units; None if too few follow any."""
    if len(body.readings) < _FEWEST_POSES:
        return None
    rows = np.linspace(0, len(body.readings) - 1, _REFERENCES).astype(int)  # one of them may hold a slip
    lines = [line for at in rows for line in _lines(body, int(at)) if _is_followed(body, line)]
    return max(lines, key=lambda line: (int(line.follows.sum()), -line.rms)) if lines else None


def _is_followed(body: DrivenBody, line: _FollowedDrive) -> bool:
    enough = line.follows.sum() >= max(_FEWEST_POSES, _FOLLOW * len(line.follows))
    return bool(enough and len(np.unique(body.readings[line.follows])) >= _FEWEST_READINGS)


def _lines(body: DrivenBody, reference: int) -> Iterator[_FollowedDrive]:
    turned = np.rad2deg(log_so3(body.rotations @ body.rotations[reference].T))
    size = np.linalg.norm(turned, axis=1)
    if size.max() < _LEAST_RANGE_DEG:
        return
    axis = _common_axis(turned, size)
    angle = turned @ axis
    limit = _NEAR * float(np.ptp(angle))
    off_axis = np.linalg.norm(turned - angle[:, None] * axis, axis=1)
    for factor in _FACTORS:
        for sign in (1.0, -1.0):
            along = angle - sign * factor * body.readings
            along = along - _mode(along, limit)
            departure = np.abs(along) + np.where(off_axis > 2.0 * limit, off_axis, 0.0)
            yield _FollowedDrive(factor, body.readings + sign * along / factor, departure, limit)


def _common_axis(turned: Array, size: Array) -> Array:
    """Return the axis (3,) about which most poses are rotated, from rotation vectors (B, 3) with lengths (B,)."""
    clear = turned[size > _CLEAR * size.max()]
    units = clear / np.linalg.norm(clear, axis=1)[:, None]
    off = np.linalg.norm(np.cross(units[:, None], turned[None]), axis=2)
    return np.asarray(units[int(np.argmin(np.quantile(off, _FOLLOW, axis=1)))])


def _mode(values: Array, near: float) -> float:
    """Return the median of the largest group of values (B,) that are near one of them."""
    close = np.abs(values[:, None] - values) <= near
    return float(np.median(values[close[int(close.sum(axis=1).argmax())]]))


def _shift(body: DrivenBody) -> RecordSlip | None:
    """Return the shift of rows after which all poses follow the drive; None if there is none."""
    for shift in _SHIFTS:
        line = _best_line(body.shifted(shift)) if len(body.readings) > _FEWEST_POSES + abs(shift) else None
        if line is not None and line.factor == 1.0 and line.follows.all():
            return RecordSlip(SlipKind.ROWS_SHIFTED, body.column, (), shift=shift)
    return None


def _slip(body: DrivenBody, line: _FollowedDrive) -> RecordSlip:
    """Return the slip that explains the poses which do not follow: two exchanged, a frozen reading, or others."""
    where = tuple(row_places(~line.follows, line.follows, body.poses, body.groups))
    for slip, rotations in body.mirrored:
        undone = np.where(line.follows[:, None, None], body.rotations, rotations)
        right = _best_line(replace(body, rotations=undone))
        if right is not None and right.follows.all():
            return replace(slip, subjects=(*where, body.body))
    deviating_rows = np.flatnonzero(~line.follows)
    expected, recorded = line.expected[deviating_rows], body.readings[deviating_rows]
    if len(deviating_rows) == _PAIR and (np.abs(expected - recorded[::-1]) <= line.limit).all():
        return RecordSlip(
            SlipKind.ROWS_EXCHANGED, body.column, tuple(body.poses[row] for row in deviating_rows.tolist())
        )
    if len(deviating_rows) > _PAIR and np.ptp(recorded) == 0.0 and np.ptp(expected) > 2.0 * line.limit:
        return RecordSlip(SlipKind.FROZEN, body.column, where)
    return RecordSlip(SlipKind.STRAY, f"{body.column} or points", where)
