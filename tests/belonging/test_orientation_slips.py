"""Euler angles in other orders and units, and conventions that are wrong in some poses, are named; honest ones pass."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.belonging.orientation_slips import COUNT, MeasuredArm, about, angles_of, arm, read
from truing.belonging.orientations import TurningMisfit, turning_misfit
from truing.belonging.rotation_writing import WrittenRotations

SEEDS = (40, 41)
LATE = np.arange(COUNT) >= COUNT // 2
THIRD = np.arange(COUNT) % 3 == 1
DEGREE = np.pi / 180.0
Change = Callable[[np.ndarray], list[float] | np.ndarray]


def misfit_of(made: MeasuredArm, numbers: np.ndarray, order: str) -> TurningMisfit:
    """Test of numbers (B, 3), rad, that are read as Euler angles in an order."""
    written = WrittenRotations.of_table(read(numbers, order), order, numbers)
    assert written.angles is not None
    return turning_misfit(made.links, written, (made.by_chain, made.seen))


def numbers_of(made: MeasuredArm, wrong: Change, rows: np.ndarray | None = None) -> np.ndarray:
    """Euler angles (B, 3) in the order ZYX, and others in some rows."""
    rows = np.ones(COUNT, bool) if rows is None else rows
    return np.array(
        [wrong(R) if is_wrong else angles_of(R, "ZYX") for R, is_wrong in zip(made.measured, rows, strict=True)]
    )


def names(misfit: TurningMisfit) -> set[tuple[str, str, float]]:
    """Kind, first subject and factor of each slip."""
    return {(slip.kind.value, " ".join(slip.subjects), round(slip.factor, 4)) for slip in misfit.slips}


WRONG: tuple[tuple[str, Change, tuple[str, str, float]], ...] = (
    ("proper angles", lambda R: angles_of(R, "ZYZ"), ("rotation", "ZYZ", 1.0)),
    ("proper angles about x", lambda R: angles_of(R, "ZXZ"), ("rotation", "ZXZ", 1.0)),
    ("other order", lambda R: angles_of(R, "XYZ"), ("rotation", "XYZ", 1.0)),
    ("columns in reverse", lambda R: angles_of(R, "ZYX")[::-1], ("rotation", "xyz", 1.0)),
    ("radians", lambda R: DEGREE * np.array(angles_of(R, "ZYX")), ("unit", "", 57.2958)),
    ("gon", lambda R: np.array(angles_of(R, "ZYX")) / 0.9, ("unit", "", 0.9)),
    ("degrees read as gon", lambda R: np.array(angles_of(R, "ZYX")) * 0.9, ("unit", "", 1.1111)),
    ("inverse", lambda R: angles_of(R.T, "ZYX"), ("rotation", "inverse", 1.0)),
)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("wrong", "name"), [case[1:] for case in WRONG], ids=[case[0] for case in WRONG])
def test_a_slip_in_all_angles_is_named(wrong: Change, name: tuple[str, str, float], seed: int) -> None:
    made = arm(seed)
    misfit = misfit_of(made, numbers_of(made, wrong), "ZYX")
    assert misfit.before > misfit.limit
    assert name in names(misfit)
    assert len(misfit.slips) <= 2  # two readings of the same numbers may be equal
    assert misfit.rows is None


@pytest.mark.parametrize(("rows", "seed"), [(LATE, 42), (THIRD, 43)], ids=["half", "third"])
@pytest.mark.parametrize(("wrong", "name"), [case[1:] for case in WRONG], ids=[case[0] for case in WRONG])
def test_a_slip_in_some_poses_is_named_with_them(
    wrong: Change, name: tuple[str, str, float], rows: np.ndarray, seed: int
) -> None:
    made = arm(seed)
    misfit = misfit_of(made, numbers_of(made, wrong, rows), "ZYX")
    assert misfit.before > misfit.limit
    assert name in names(misfit)
    assert misfit.rows is not None
    assert not (misfit.rows[0] & ~rows).any()
    assert misfit.rows[0].sum() > 0.8 * rows.sum()  # small angles agree in several readings
    assert misfit.after < 0.01


@pytest.mark.parametrize("seed", range(60, 66))
@pytest.mark.parametrize("travel", [0.3, 1.3])
@pytest.mark.parametrize("order", ["ZYX", "ZYZ"])
def test_angles_as_declared_pass(seed: int, travel: float, order: str) -> None:
    made = arm(seed, travel)
    misfit = misfit_of(made, np.array([angles_of(R, order) for R in made.measured]), order)
    assert misfit.before < misfit.limit
    assert not misfit.slips
    assert not misfit.stray.any()


@pytest.mark.parametrize("seed", range(80, 84))
def test_zeros_off_by_degrees_are_no_slip_of_some_poses(seed: int) -> None:
    """A joint between base and tool with a wrong zero: orientations miss the chain by degrees."""
    made, rng = arm(seed), np.random.default_rng(seed)
    angle = rng.uniform(-1.5, 1.5, COUNT)
    wrist = np.array([about("X", value) for value in angle])
    off = made.measured @ about("Y", 0.07) @ wrist
    written = WrittenRotations(off, "ZYX", np.array([angles_of(R, "ZYX") for R in off]))
    misfit = turning_misfit(made.links @ wrist, written)
    assert not misfit.slips


@pytest.mark.parametrize("seed", SEEDS)
def test_readings_that_are_wrong_in_some_poses_are_no_slip_of_orientations(seed: int) -> None:
    """The first axis of the arm counts the other way in half of the poses: positions of these poses miss, too."""
    made = arm(seed)
    flip = np.diag([1.0, -1.0, -1.0])
    links = np.where(LATE[:, None, None], flip @ made.links @ flip, made.links)
    by_chain = np.where(LATE[:, None], made.by_chain @ flip, made.by_chain)
    written = WrittenRotations(made.measured, "ZYX", np.array([angles_of(R, "ZYX") for R in made.measured]))
    assert not turning_misfit(links, written, (by_chain, made.seen)).slips


@pytest.mark.parametrize("seed", SEEDS)
def test_inverse_poses_among_others_are_distinguished_from_inverse_orientations(seed: int) -> None:
    made = arm(seed)
    measured, seen = made.measured.copy(), made.seen.copy()
    measured[LATE] = np.swapaxes(measured[LATE], 1, 2)
    seen[LATE] = -np.einsum("bij,bj->bi", measured[LATE], seen[LATE])
    (slip,) = turning_misfit(made.links, WrittenRotations(measured), (made.by_chain, seen)).slips
    assert (slip.quantity, slip.subjects) == ("measured poses", ("inverse",))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_scalar_at_the_other_end_is_named_where_it_concerns_some_poses(seed: int) -> None:
    made = arm(seed)
    q = Rotation.from_matrix(made.measured).as_quat()
    q[LATE] = np.roll(q[LATE], 1, axis=1)
    written = WrittenRotations(Rotation.from_quat(q).as_matrix())
    misfit = turning_misfit(made.links, written, (made.by_chain, made.seen))
    assert ("rotation", "scalar at the other end", 1.0) in names(misfit)
    assert misfit.rows is not None
    assert (misfit.rows[0] == LATE).all()
