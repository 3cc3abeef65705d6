"""Result of one consistency test between two parts of a campaign, and the slips (recording mistakes) that
explain it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

_MOST_NAMED = 3


class RelationState(StrEnum):
    """State of a relation after its test."""

    OK = "ok"
    ATTENTION = "attention"
    FAILS = "fails"
    NOT_TESTED = "not tested"


class SlipKind(StrEnum):
    """Kind of change that a person or an export made to numbers between instrument and table."""

    UNIT = "unit"  # all numbers times a factor between units
    SIGN = "sign"  # all numbers times -1
    ZERO = "zero"  # counted from another zero
    COLUMNS = "columns-exchanged"
    ADDED = "lacks-the-one-before"  # the first subject is to be added to the second
    SUBTRACTED = "holds-the-one-before"  # the first subject is to be subtracted from the second
    ROWS_SHIFTED = "rows-shifted"
    ROWS_EXCHANGED = "rows-exchanged"
    MIRRORED = "mirrored"
    PARTS_EXCHANGED = "parts-exchanged"  # two parts of the description stand in each other's place
    DIRECTION = "direction-reversed"
    FROZEN = "frozen"  # constant while the machine moves
    SILENT = "no-response"  # hardly changed while the load changes that should move it
    COPIED = "copied"
    STRAY = "stray"  # single numbers far from their expected values: a misread digit, a number of another row
    ROUNDED = "rounded"  # written down in steps far above the noise
    FRINGES = "counted-in-fringes"  # numbers of fringes in place of lengths; multiplied by factor they are right
    MISLABELLED = "mislabelled"  # one part bears the label of another
    RELABELLED = "relabelled"  # names of all parts are in another order
    CONVENTION = "convention"  # rows of a chain in the other convention of Denavit and Hartenberg
    SCALE = "scale"  # multiplied by factor, points have the size of their survey; no unit explains it
    ROTATION = "rotation"  # written in another form: `RotationForm`
    FRAME = "frame-moved"  # from the first subject on, places are in another frame of the instrument
    PLACED = "survey-placed"  # the survey of a body is in another frame than that of its link
    OTHER_FRAME = "other-frame"  # poses are those of other frames than the joints of base and platform have
    REVERSED = "rows-reversed"  # from the last to the first
    LATE = "late"  # recorded by another clock, or following late


class RotationForm(StrEnum):
    """Form in which rotations, or positions with them, were written in place of the declared one."""

    INVERSE = "inverse"
    INVERSION = "inversion"  # inverse, or a slip that an unknown base and tool make equivalent to it
    BODY_AXES = "body axes"  # positions along the axes of the body
    OF_INVERSE = "of the inverse"  # positions of the inverse poses
    SCALAR_AT_OTHER_END = "scalar at the other end"  # of quaternions
    VECTOR = "rotation vector"  # in place of Euler angles
    EULER = "euler"  # Euler angles in another order
    AXES = "axes"  # components of other axes in the columns of x, y, z


@dataclass(frozen=True)
class RecordSlip:
    """One slip: its kind, the quantity that it changed, the subjects (columns, rows, runs), and its size.

    ``factor``: recorded numbers multiplied by it are right (kind unit), 1 for other kinds. ``shift``: number of rows by
    which the recorded values are too far down (kind rows-shifted). ``offset``: to be added, in the unit of the column
    (kind zero); the delay in s (kind late). ``rows``: rows of the first subject, from 1 (kind copied; none: all).
    ``dimension`` of the quantity: length, angle, force, torque or voltage. ``form`` of rotations and ``order`` of their
    Euler angles (ZYX) or axes (yzx): kind rotation, whose first subject repeats them in words. ``frames``: bodies with
    x, y, z in mm and a rotation vector in degrees (kind other-frame): of the base, its frame in that of the measured
    poses; of the platform, the measured frame in that of its joints.
    """

    kind: SlipKind
    quantity: str
    subjects: tuple[str, ...] = ()
    factor: float = 1.0
    shift: int = 0
    offset: float = 0.0
    dimension: str = "length"
    rows: tuple[int, ...] = ()
    form: RotationForm | None = None
    order: str = ""
    frames: tuple[tuple[str, tuple[float, ...]], ...] = ()


@dataclass(frozen=True)
class RelationTest:
    """Result of the test of one relation: slips that explain the data, and slips that a campaign of this kind cannot
    show.

    ``relation`` is the name of the quality check. ``misfit`` is the rms misfit as recorded, ``misfit_explained`` with
    ``slips`` undone (None without slips). Both are in ``unit``, where 1 stands for a count or ratio. A relation fails
    beyond ``limit``. ``slips`` apply together; ``rivals`` explain the data as well. ``tried`` counts the hypotheses.
    ``hidden``: slips that would not show. ``reason`` is a code for the words.
    """

    relation: str
    state: RelationState
    reason: str
    subject: str = ""
    misfit: float | None = None
    misfit_explained: float | None = None
    limit: float | None = None
    unit: str = ""
    slips: tuple[RecordSlip, ...] = ()
    rivals: tuple[RecordSlip, ...] = ()
    tried: int = 0
    hidden: tuple[RecordSlip, ...] = ()


def named_shortly(names: Sequence[str]) -> str:
    """Return the subject of a test for a few names; empty where they are too many."""
    return ", ".join(names) if len(names) <= _MOST_NAMED else ""


# What numbers of one unit are in another, by which a slip multiplies; each may also be divided by.
LENGTH_FACTORS = (1e3, 10.0, 25.4, 1e6)


def both_ways(factors: tuple[float, ...]) -> tuple[float, ...]:
    """Return factors and their reciprocals."""
    return (*factors, *(1.0 / factor for factor in factors))


# Recorded loads and readings times these are right: N and N m; um; arc seconds; mV. Raw counts are of half, a quarter
# or an eighth of a wavelength, by how often light passes. An
# interferometer set to another number of passes shows displacements off by a factor of two.
FORCE_UNITS = both_ways((1e3, 10.0, 9.80665, 4.4482216152605))
TORQUE_UNITS = (*both_ways((1e3, 10.0, 9.80665, 1.3558179483314, 0.1129848290276)), 0.01, 0.00980665)
DISPLACEMENT_UNITS = (1e3, 1e-3, 1e6, 25.4, 25400.0, 2.0, 0.5)
ROTATION_UNITS = (206264.80624709636, 3600.0, 60.0, 206.26480624709636, 0.20626480624709636)
SIGNAL_FACTORS = (1e3, 1e-3, 0.5, 2.0)
FRINGE_SHARES = (0.5, 0.25, 0.125)
