"""Proofs over a range of poses: enclosures hold, and false statements are not proven."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.mechanisms.telescope import telescope
from truing.estimation.interval_arithmetic import hull, intervals, product
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.change import Change
from truing.simulation.mechanisms.legs.closures import Closure, Legs, mechanism
from truing.simulation.mechanisms.legs.kinematics import inverse, reference_pose
from truing.simulation.mechanisms.structures.beam_model import BeamModel
from truing.simulation.mechanisms.structures.structure import Machine, readings_at
from truing.simulation.mechanisms.uniqueness import Flexures, PoseBox, _prepared, prove_uniqueness

DEGREE = np.pi / 180.0
LENGTHS, BETA = np.full(6, 0.01), np.linspace(0.1, 0.4, 6)
FLEXURES = Flexures(LENGTHS, BETA)


def box_of(legs: Legs, position: list[float], rotation: list[float], readings: float) -> PoseBox:
    """A range about the reference pose, mm and degrees."""
    reference = reference_pose(legs)
    half = 1e-3 * np.array(position), DEGREE * np.array(rotation), np.full(legs.count, 1e-3 * readings)
    return PoseBox(reference.p[0], reference.R[0], *half)


def workspace(legs: Legs) -> PoseBox:
    return box_of(legs, [1.0, 1.0, 0.1], [0.5, 0.5, 2.5], 1.3)


def hexapod() -> Legs:
    """Planar joints on both sides: the platform above the base, or below it, has the same lengths."""
    about = np.linspace(0.0, 2 * np.pi, 6, endpoint=False)
    base = np.repeat(about[::2], 2) + np.tile([-0.2, 0.2], 3)
    top = np.repeat(about[1::2], 2) + np.tile([-0.2, 0.2], 3)
    a, b = (size * np.stack([np.cos(at), np.sin(at), 0 * at], -1) for size, at in ((0.3, base), (0.2, np.roll(top, 1))))
    lengths = np.linalg.norm(b + np.array([0.0, 0.0, 0.35]) - a, axis=-1)
    return mechanism("ups", a, b, None, lengths, np.zeros(6))


def poses_in(box: PoseBox, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    p = box.p + box.position * rng.uniform(-1, 1, (count, 3))
    return p, exp_so3(box.rotation * rng.uniform(-1, 1, (count, 3))) @ box.R


def test_the_telescope_has_one_pose_for_its_readings_with_and_without_flexures() -> None:
    for flexures in (None, FLEXURES):
        found = prove_uniqueness(telescope(), workspace(telescope()), flexures)
        assert found.unique
        assert found.regular
        assert found.inverse_unique.all()
        assert found.singular is None
        assert not len(found.undecided)


def test_a_range_of_centimetres_is_proven_in_parts() -> None:
    found = prove_uniqueness(telescope(), box_of(telescope(), [20.0, 20.0, 20.0], [4.0, 4.0, 10.0], 10.0))
    assert found.unique
    assert found.boxes > 1


def test_two_poses_of_equal_readings_are_not_proven_to_be_one() -> None:
    """The mirrored platform is within the range, and so is a singular one between the two."""
    legs = hexapod()
    reference = reference_pose(legs)
    mirrored = reference.p[0] * [1.0, 1.0, -1.0]
    np.testing.assert_allclose(inverse(legs, mirrored[None], np.eye(3)[None])[0], 0.0, atol=1e-12)
    both = box_of(legs, [1.0, 1.0, 2.001e3 * reference.p[0, 2]], [1.0, 1.0, 1.0], 1e3)
    found = prove_uniqueness(legs, both, most=2000)
    assert not found.unique
    assert not found.regular
    low, high = found.undecided[:, 0], found.undecided[:, 1]
    flat = np.array([0.0, 0.0, -reference.p[0, 2], 0.0, 0.0, 0.0])
    assert ((low <= flat) & (flat <= high)).all(-1).any()
    one = prove_uniqueness(legs, box_of(legs, [20.0] * 3, [5.0] * 3, 1e3))
    assert one.unique


def test_the_other_sign_of_the_determinant_refutes_regularity() -> None:
    legs = hexapod()
    wide = box_of(legs, [1.0, 1.0, 700.0], [1.0, 1.0, 1.0], 1e3)
    found = prove_uniqueness(legs, wide, most=2000)
    assert found.singular is not None
    assert reference_pose(legs).p[0, 2] + found.singular[2] < 0.0


@pytest.mark.parametrize("kind", ["6-pus", "ups"])
def test_the_difference_of_two_closures_lies_within_the_rows_at_their_midpoint(kind: str) -> None:
    legs = telescope() if kind == "6-pus" else hexapod()
    box = box_of(legs, [10.0] * 3, [8.0, 8.0, 8.0], 5.0)
    half = box.half
    rows, _ = _prepared(legs, box, hull(-half, half), None)
    (p, R), (q, S) = poses_in(box, 40, 1), poses_in(box, 40, 2)
    rho = legs.rho0 + box.readings * np.random.default_rng(3).uniform(-1, 1, (40, 6))
    lower = legs.closure.lower(legs, rho)
    square = [
        np.sum((at[:, None] + legs.b @ np.swapaxes(turn, -1, -2) - lower) ** 2, -1) for at, turn in ((p, R), (q, S))
    ]
    theta = log_so3(R @ np.swapaxes(S, -1, -2))
    angle = np.linalg.norm(theta, axis=-1, keepdims=True)
    w = 2.0 * np.sin(angle / 2.0) * theta / angle
    halfway = log_so3(exp_so3(0.5 * theta) @ S @ box.R.T)
    size = np.linalg.norm(halfway, axis=-1, keepdims=True)
    middle = np.concatenate([0.5 * (p + q) - box.p, halfway * np.tan(size / 2.0) / size], -1)
    found = product(rows.at(middle - 1e-12, middle + 1e-12), intervals(np.concatenate([p - q, w], -1)[..., None]))
    wanted = 0.5 * (square[0] - square[1])
    assert ((found.low[..., 0] <= wanted) & (wanted <= found.high[..., 0])).all()
    assert (np.abs(middle) <= half).all()  # the midpoint is in the box


def test_the_slope_of_a_closure_by_its_reading_holds_the_flexures_own() -> None:
    legs, box = telescope(), workspace(telescope())
    machine = Machine(legs, np.zeros((6, 6)), LENGTHS, beta=BETA)
    p, R = poses_in(box, 200)
    rho = readings_at(BeamModel(), machine, p, R).rho
    inside = (np.abs(rho - legs.rho0) <= box.readings).all(-1)
    assert inside.sum() > 5
    closing = BeamModel().close(machine, p[inside], R[inside], rho[inside], Change({}, 0))
    slopes = np.diagonal(closing.by_rho, axis1=1, axis2=2)
    found = prove_uniqueness(legs, box, FLEXURES).reading_slope
    assert ((found[:, 0] <= slopes) & (slopes <= found[:, 1])).all()
    assert (found[:, 1] - found[:, 0] < 0.05).all()


def test_the_rows_of_flexures_hold_the_beam_model_s_jacobian() -> None:
    legs, box = telescope(), workspace(telescope())
    machine = Machine(legs, np.zeros((6, 6)), LENGTHS, beta=BETA)
    p, R = poses_in(box, 200)
    rho = readings_at(BeamModel(), machine, p, R).rho
    inside = (np.abs(rho - legs.rho0) <= box.readings).all(-1)
    p, R, rho = p[inside], R[inside], rho[inside]
    closing = BeamModel().close(machine, p, R, rho, Change({}, 0))
    g = p[:, None] + legs.b @ np.swapaxes(R, -1, -2) - legs.closure.lower(legs, rho)
    jacobian = -closing.by_twist * np.linalg.norm(g, axis=-1)[..., None]
    half = box.half
    rows, _ = _prepared(legs, box, hull(-half, half), FLEXURES)
    found = rows.at(-half[None], half[None], one_pose=True)
    assert ((found.low <= jacobian) & (jacobian <= found.high)).all()
    rigid, _ = _prepared(legs, box, hull(-half, half), None)
    # flexures change the rows by less than a per mille of their largest entries, and by more than nothing
    change = np.abs(found.mid - rigid.at(-half[None], half[None], one_pose=True).mid)
    assert 0.0 < change.max() < 1e-3


def test_an_own_type_of_leg_is_refused() -> None:
    class Mine(Closure):
        name = "mine"

    legs = telescope()
    with pytest.raises(ValueError, match="6-pus or ups, not mine"):
        prove_uniqueness(Legs(legs.a, legs.b, legs.u, legs.l, legs.rho0, Mine()), workspace(telescope()))


def test_a_range_in_which_legs_have_no_length_is_not_decided_and_raises_nothing() -> None:
    found = prove_uniqueness(telescope(), box_of(telescope(), [900.0] * 3, [60.0] * 3, 1e3), FLEXURES, most=200)
    assert not found.unique
    assert not found.inverse_unique.any()


def test_a_singular_pose_that_no_reading_of_the_range_reaches_does_not_count() -> None:
    """Both sides of the base are regular; between them the legs would be shorter than they can be."""
    legs = hexapod()
    both = box_of(legs, [1.0, 1.0, 2.001e3 * reference_pose(legs).p[0, 2]], [1.0, 1.0, 1.0], 20.0)
    found = prove_uniqueness(legs, both, most=4000)
    assert not found.unique
    assert found.regular
    assert found.singular is None
