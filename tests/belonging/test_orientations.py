"""Orientations of a link that contradict the chain: the recording mistake that explains them is named."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truing.arrays import Array
from truing.belonging.orientations import TurningMisfit
from truing.belonging.orientations import turning_misfit as misfit_of_written
from truing.belonging.rotation_writing import WrittenRotations

RNG = np.random.default_rng(3)
LINKS = Rotation.random(40, random_state=1)
BASE, TOOL = Rotation.random(2, random_state=2)
MEASURED = BASE * LINKS * TOOL * Rotation.from_rotvec(1e-3 * RNG.normal(size=(40, 3)))


def turning_misfit(
    links: Array, measured: Array, euler: str | None, positions: tuple[Array, Array] | None = None
) -> TurningMisfit:
    return misfit_of_written(links, WrittenRotations(measured, euler), positions)


def misfit_of(read: Array | Rotation, euler: str | None = None) -> TurningMisfit:
    matrices = read.as_matrix() if isinstance(read, Rotation) else read
    return turning_misfit(LINKS.as_matrix(), matrices, euler)


def slip_subjects(misfit: TurningMisfit) -> set[str]:
    return {" ".join(slip.subjects) or slip.kind.value for slip in misfit.slips}


def test_orientations_under_an_unknown_base_and_tool_belong() -> None:
    misfit = misfit_of(MEASURED)
    assert not misfit.slips
    assert 1e-3 < misfit.before < 2.5e-3 < misfit.limit


def test_a_zero_off_by_some_degrees_is_no_slip() -> None:
    bent = BASE * LINKS * Rotation.from_rotvec([0.0, 0.08, 0.0]) * Rotation.from_rotvec(0.1 * np.eye(3)[0]) * TOOL
    assert misfit_of(bent).before < 1e-6
    wrist = Rotation.from_rotvec(np.outer(RNG.uniform(-1.0, 1.0, 40), [0.0, 0.0, 1.0]))
    off = BASE * LINKS * Rotation.from_rotvec([0.0, 0.08, 0.0]) * wrist * TOOL
    misfit = turning_misfit((LINKS * wrist).as_matrix(), off.as_matrix(), None)
    assert 0.01 < misfit.before < misfit.limit
    assert not misfit.slips


@pytest.mark.parametrize(
    "changed",
    [
        lambda true: Rotation.from_quat(np.roll(true.as_quat(), 1, 1)),
        lambda true: Rotation.from_quat(np.roll(true.as_quat(), -1, 1)),
        lambda true: true.inv(),
        lambda true: Rotation.from_rotvec(true.as_rotvec()[:, [1, 0, 2]]),
        lambda true: Rotation.from_rotvec(true.as_rotvec() * [1.0, 1.0, -1.0]),
    ],
)
def test_inversions_equal_up_to_base_and_tool_are_one_slip(changed: Callable[[Rotation], Rotation]) -> None:
    misfit = misfit_of(changed(MEASURED))
    assert slip_subjects(misfit) == {"inversion"}
    assert misfit.after < 3e-3 < 0.1 * misfit.before


def test_a_mirrored_frame_cannot_be_seen_in_orientations_alone() -> None:
    mirror = np.diag([1.0, -1.0, 1.0])
    misfit = misfit_of(mirror @ MEASURED.as_matrix() @ mirror)
    assert not misfit.slips
    assert misfit.before < 2.5e-3


def test_inverses_of_euler_angles_are_reported_alone() -> None:
    assert "inverse" in slip_subjects(misfit_of(MEASURED.inv(), "ZYX"))


@pytest.mark.parametrize("order", ["xyz", "ZYX"])
def test_euler_angles_read_as_rotation_vectors_are_reported_where_turns_are_small(order: str) -> None:
    small = Rotation.from_rotvec(np.random.default_rng(5).normal(0.0, 0.25, (60, 3)))
    noise = Rotation.from_rotvec(1e-4 * RNG.normal(size=(60, 3)))
    read = Rotation.from_rotvec((small * noise).as_euler(order))
    misfit = turning_misfit(small.as_matrix(), read.as_matrix(), None)
    assert order in slip_subjects(misfit)
    assert order != "xyz" or misfit.before < np.deg2rad(3.0)


def test_euler_angles_in_another_order_are_reported_with_that_order() -> None:
    read = Rotation.from_euler("XYZ", MEASURED.as_euler("ZYX"))
    assert "ZYX" in slip_subjects(misfit_of(read, "XYZ"))


def test_orientations_of_another_link_have_no_slip_that_explains_them() -> None:
    misfit = misfit_of(Rotation.random(40, random_state=9))
    assert misfit.before > misfit.limit
    assert not misfit.slips


def test_single_orientations_far_from_the_others_are_reported_and_do_not_count() -> None:
    wrong = MEASURED.as_matrix().copy()
    wrong[[6, 21]] = wrong[[6, 21]] @ Rotation.from_rotvec([0.0, 1.0, 0.0]).as_matrix()
    misfit = misfit_of(wrong)
    assert np.flatnonzero(misfit.stray).tolist() == [6, 21]
    assert misfit.before < 2.5e-3
    assert not misfit.slips


@pytest.mark.parametrize(("right", "read"), [("xyz", "XYZ"), ("ZYX", "xyz"), ("yzx", "XYZ")])
def test_positions_distinguish_the_order_of_euler_angles_from_its_cyclic_exchanges(right: str, read: str) -> None:
    places = RNG.normal(size=(40, 3))
    seen = places @ BASE.as_matrix().T + MEASURED.as_matrix() @ [0.1, 0.05, 0.2] + [1.0, 2.0, 3.0]
    seen += 1e-3 * RNG.normal(size=(40, 3))
    misread = Rotation.from_euler(read, MEASURED.as_euler(right)).as_matrix()
    without = turning_misfit(LINKS.as_matrix(), misread, read)
    assert len({right, *slip_subjects(without)}) == len(without.slips) > 1  # orientations alone leave several
    with_them = turning_misfit(LINKS.as_matrix(), misread, read, (places, seen))
    assert all(np.allclose(_read(order, right), MEASURED.as_matrix()) for order in slip_subjects(with_them))
    assert right in slip_subjects(with_them) or right.swapcase()[::-1] in slip_subjects(with_them)


def _read(order: str, right: str) -> Array:
    return Rotation.from_euler(order, MEASURED.as_euler(right)).as_matrix()


def test_orders_of_euler_angles_that_are_equal_but_for_base_and_tool_leave_equal_misfits() -> None:
    """Orientations of a tool that points about one way: base and tool are found slowly there."""
    turns = Rotation.from_euler("xyz", RNG.uniform(-1.0, 1.0, (30, 3)) * np.deg2rad([15.0, 14.0, 30.0]))
    measured = BASE * turns * TOOL * Rotation.from_rotvec(1e-3 * RNG.normal(size=(30, 3)))
    read = Rotation.from_euler("XYZ", measured.as_euler("xyz")).as_matrix()
    slips = slip_subjects(turning_misfit(turns.as_matrix(), read, "XYZ"))
    assert {"xyz", "yzx", "zxy"} <= slips


def _seen(orientations: Array, base: Array) -> tuple[Array, Array]:
    """Positions by the chain and as measured, of a point of the body whose orientations are measured."""
    places = RNG.normal(size=(len(orientations), 3))
    seen = places @ base.T + orientations @ [0.1, 0.05, 0.2] + [1.0, 2.0, 3.0]
    return places, seen + 1e-3 * RNG.normal(size=seen.shape)


def test_poses_written_as_inverses_are_reported_as_such() -> None:
    right = MEASURED.as_matrix()
    places, seen = _seen(right, BASE.as_matrix())
    inverse = np.swapaxes(right, 1, 2)
    position = -np.einsum("bij,bj->bi", inverse, seen)
    (slip,) = turning_misfit(LINKS.as_matrix(), inverse, None, (places, position)).slips
    assert (slip.quantity, slip.subjects) == ("measured poses", ("inverse",))
    (slip,) = turning_misfit(LINKS.as_matrix(), inverse, None, (places, seen)).slips
    assert (slip.quantity, slip.subjects) == ("measured orientations", ("inversion",))


@pytest.mark.parametrize(("sign", "written"), [(1.0, "body axes"), (-1.0, "of the inverse")])
def test_positions_along_the_axes_of_the_body_are_reported(sign: float, written: str) -> None:
    right = MEASURED.as_matrix()
    places, seen = _seen(right, BASE.as_matrix())
    position = sign * np.einsum("bji,bj->bi", right, seen)
    misfit = turning_misfit(LINKS.as_matrix(), right, None, (places, position))
    assert [(slip.quantity, slip.subjects) for slip in misfit.slips] == [("measured positions", (written,))]
    assert misfit.apart is not None
    assert misfit.apart_after is not None
    assert misfit.apart_after < 0.01 < misfit.apart


@pytest.mark.parametrize(("order", "written"), [([1, 2, 0], "components yzx"), ([2, 0, 1], "components zxy")])
def test_components_moved_on_turn_orientations_out_of_the_frame_of_positions(order: list[int], written: str) -> None:
    places, seen = _seen(MEASURED.as_matrix(), BASE.as_matrix())
    moved = Rotation.from_rotvec(MEASURED.as_rotvec()[:, order]).as_matrix()
    assert not turning_misfit(LINKS.as_matrix(), moved, None).slips  # orientations alone cannot show it
    misfit = turning_misfit(LINKS.as_matrix(), moved, None, (places, seen))
    assert slip_subjects(misfit) == {written}


@pytest.mark.parametrize("seed", range(4))
def test_orientations_about_one_axis_leave_the_base_to_positions(seed: int) -> None:
    """An arm of parallel axes: its orientations determine no base, and contradict none."""
    rng = np.random.default_rng(seed)
    links = Rotation.from_rotvec(np.outer(rng.uniform(-3.0, 3.0, 30), [0.0, 0.0, 1.0]))
    measured = BASE * links * TOOL * Rotation.from_rotvec(1e-3 * rng.normal(size=(30, 3)))
    misfit = turning_misfit(
        links.as_matrix(), measured.as_matrix(), None, _seen(measured.as_matrix(), BASE.as_matrix())
    )
    assert misfit.apart is None
    assert not misfit.slips


@pytest.mark.parametrize("degrees", [0.0, 5.0])
def test_a_base_turned_by_wrong_zeros_is_no_other_frame(degrees: float) -> None:
    turned = Rotation.from_rotvec([0.0, np.radians(degrees), 0.0]) * BASE
    near = _seen(MEASURED.as_matrix(), turned.as_matrix())
    assert turning_misfit(LINKS.as_matrix(), MEASURED.as_matrix(), None, near).apart is None
