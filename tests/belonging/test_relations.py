"""Relations between arrays: physical effects are no slip, and undetectable slips are listed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.tolerance import assert_close
from truing.belonging import relation
from truing.belonging.body_point_tests import relate_survey as survey_of
from truing.belonging.body_points import BodyPoints
from truing.belonging.copied_poses import relate_copies as copies
from truing.belonging.evidence import log_evidence, physics
from truing.belonging.reading_hypotheses import MeasuredMotion
from truing.belonging.reading_row_slips import ReadingNames
from truing.belonging.reading_tests import relate_readings as relations
from truing.belonging.relation import RelationState, SlipKind
from truing.belonging.target_names import NamedTargets
from truing.simulation.mechanisms.legs.closures import mechanism
from truing.simulation.mechanisms.legs.kinematics import forward, inverse

NOISE = 2e-6
TOLERANCE = {"a": 5e-4, "b": 5e-4, "l": 5e-4, "u": 2e-3}


def _legs():
    angle = np.deg2rad([40, 80, 160, 200, 280, 320])
    base = np.stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), np.zeros(6)], -1)
    other = np.deg2rad([10, 110, 130, 230, 250, 350])
    platform = np.stack([0.12 * np.cos(other), 0.12 * np.sin(other), np.zeros(6)], -1)
    return mechanism("6-pus", base, platform, None, np.full(6, 0.5), np.full(6, 0.01))


def _motion(travel: np.ndarray, change=lambda readings: readings, seed: int = 0) -> tuple[MeasuredMotion, ReadingNames]:
    """Poses that the true readings 10 mm + travel (B, 6) lead to, and readings as they were written down."""
    rng = np.random.default_rng(seed)
    legs, true = _legs(), 0.01 + travel
    found = forward(legs, true)
    readings = change(true + NOISE * rng.standard_normal(true.shape))
    motion = MeasuredMotion(legs, TOLERANCE, found.p, found.R, readings, NOISE, np.zeros((len(true), 0)))
    columns = tuple(f"rho{leg}_mm" for leg in range(1, 7))
    return motion, ReadingNames(columns, tuple(str(pose) for pose in range(len(true))))


def _readings(*given) -> relation.RelationTest:
    return next(one for one in relations(*_motion(*given)) if one.relation == "readings-against-poses")


def _travel(count: int = 20, size: float = 1e-3) -> np.ndarray:
    return np.random.default_rng(5).uniform(-size, size, (count, 6))


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda r: 0.01 + 1.3 * (r - 0.01), id="all gains 30 % off"),
        pytest.param(lambda r: r + 4e-3, id="another zero of 4 mm, which lengths would be as well"),
        pytest.param(lambda r: r + np.array([2, -3, 4, -5, 3, -2]) * 1e-3, id="geometry off by ten tolerances"),
        pytest.param(lambda r: r + 1e-4 * np.sin(r / 1e-4), id="a periodic error of a tenth of the travel"),
        pytest.param(lambda r: r @ (np.eye(6) + 0.1 * np.roll(np.eye(6), 1, 0)), id="a tenth of the next leg"),
    ],
)
def test_physics_is_no_slip(change) -> None:
    found = _readings(_travel(), change)
    assert not found.slips
    assert found.state is not RelationState.FAILS


def _flipped(joints: np.ndarray, leg: int, axis: int) -> np.ndarray:
    found = joints.copy()
    found[leg, axis] *= -1.0
    return found


@pytest.mark.parametrize(
    ("change", "kind", "quantity", "subjects"),
    [
        (lambda legs: {"a": _flipped(legs.a, 4, 1)}, SlipKind.SIGN, "y of a_mm of", ("leg 5",)),
        (
            lambda legs: {"a": _flipped(legs.a, 1, 1), "b": _flipped(legs.b, 1, 1)},
            SlipKind.SIGN,
            "y of a_mm and b_mm of",
            ("leg 2",),
        ),
        (
            lambda legs: {"b": legs.b[[0, 3, 2, 1, 4, 5]]},
            SlipKind.PARTS_EXCHANGED,
            "b_mm of [mechanism]",
            ("leg 2", "leg 4"),
        ),
        (lambda legs: {"b": 2.0 * legs.b}, SlipKind.UNIT, "b_mm of [mechanism]", ()),
        (lambda legs: {"l": legs.l + 0.05}, SlipKind.UNIT, "length_mm", ()),
    ],
    ids=["a sign of one joint", "a mirrored leg", "two joints", "diameter for radius", "legs 50 mm too long"],
)
def test_a_slip_in_the_description_is_named(change, kind: SlipKind, quantity: str, subjects: tuple[str, ...]) -> None:
    motion, names = _motion(_travel())
    wrong = replace(motion, legs=motion.legs.replace(**change(motion.legs)))
    found = next(one for one in relations(wrong, names) if one.relation == "readings-against-poses")
    assert found.state is RelationState.FAILS
    assert [(slip.kind, slip.quantity, slip.subjects) for slip in found.slips] == [(kind, quantity, subjects)]


def _turned_by(degrees: list[float]) -> np.ndarray:
    return Rotation.from_rotvec(degrees, degrees=True).as_matrix()


@pytest.mark.parametrize("turn", [[1.0, -2.0, 170.0], [0.0, 0.0, -15.0], [30.0, 40.0, 80.0]])
def test_poses_in_the_frame_of_an_instrument_are_named_with_its_place(turn: list[float]) -> None:
    motion, names = _motion(_travel(size=5e-3))
    R, t, tool, place = _turned_by(turn), np.array([1.2, -0.4, 2.0]), _turned_by([0.0, 5.0, 40.0]), [0.02, 0.01, 0.1]
    p = t + (motion.p + motion.R @ place) @ R.T
    seen = replace(motion, p=p, R=R @ motion.R @ tool)
    found = next(one for one in relations(seen, names) if one.relation == "readings-against-poses")
    assert (found.state, found.reason) == (RelationState.FAILS, "slip")
    assert [slip.kind for slip in found.slips] == [SlipKind.OTHER_FRAME]
    frames = dict(found.slips[0].frames)
    assert_close(frames["base"], [*(1e3 * t), *turn], atol=2.0)
    assert_close(frames["platform"][:3], [20.0, 10.0, 100.0], atol=2.0)
    assert found.misfit_explained is not None
    assert found.misfit_explained < 0.05


def test_rows_that_fit_nowhere_are_not_said_to_be_exchanged() -> None:
    """Among poses far from their readings, chance finds an order of rows that fits a little better."""
    rng = np.random.default_rng(29)
    own, count = _legs(), 60
    legs = mechanism("ups", own.a, own.b, None, np.full(6, 0.5), np.zeros(6))
    p = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.04, 0.04, (count, 3))
    R = Rotation.from_rotvec(rng.uniform(-0.12, 0.12, (count, 3))).as_matrix()
    readings = inverse(legs, p, R).real + NOISE * rng.standard_normal((count, 6))
    turn = _turned_by([-1.0, 2.5, 170.0])
    seen = MeasuredMotion(
        legs, TOLERANCE, np.array([1.2, -0.4, -1.3]) + p @ turn.T, turn @ R, readings, NOISE, np.zeros((count, 0))
    )
    names = ReadingNames(tuple(f"rho{leg}_mm" for leg in range(1, 7)), tuple(str(pose) for pose in range(count)))
    found = next(one for one in relations(seen, names) if one.relation == "readings-against-poses")
    assert [slip.kind for slip in found.slips] == [SlipKind.OTHER_FRAME]


def test_names_of_targets_in_any_order_are_found() -> None:
    rng = np.random.default_rng(4)
    survey = rng.uniform(-0.2, 0.2, (9, 3))
    names, order = tuple(f"P{k}" for k in range(9)), rng.permutation(9)
    points = survey[order] + 1e-5 * rng.standard_normal((6, 9, 3))
    is_observed = rng.random((6, 9)) > 0.2
    body = BodyPoints(
        "platform", survey, points, is_observed, 1e-5, named=NamedTargets(names, survey, points, is_observed)
    )
    found = survey_of(body)
    moved = [f"P{k} is P{place}" for k, place in enumerate(order) if k != place]
    assert (found.state, [slip.kind for slip in found.slips]) == (RelationState.FAILS, [SlipKind.RELABELLED])
    assert found.slips[0].subjects == (*moved, "platform")
    other = rng.uniform(-0.2, 0.2, (6, 1, 3)) * np.ones((9, 1)) + rng.uniform(-0.2, 0.2, (9, 3))
    foreign = replace(body, points=other, named=NamedTargets(names, survey, other, is_observed))
    assert not survey_of(foreign).slips, "points of another body are in no order"


def test_columns_of_legs_that_move_alike_cannot_be_distinguished() -> None:
    together = np.linspace(-1e-3, 1e-3, 15)[:, None] * np.ones(6)
    found = _readings(together)
    assert found.state is RelationState.OK
    assert len(found.hidden) == 15  # every pair
    assert all(slip.kind is SlipKind.COLUMNS for slip in found.hidden)
    exchanged = _readings(together, lambda r: r[:, [1, 0, 2, 3, 4, 5]])
    assert exchanged.state is RelationState.OK
    assert _readings(together, lambda r: 1e-3 * r).slips[0].kind is SlipKind.UNIT


def test_poses_that_hardly_moved_are_not_compared() -> None:
    assert _readings(_travel(size=1e-6)).state is RelationState.NOT_TESTED


def test_two_poses_are_not_compared() -> None:
    assert _readings(_travel(2)).reason == "no-poses"


def test_readings_of_nothing_at_all_fail_without_a_name() -> None:
    found = _readings(_travel(), lambda r: 0.01 + np.random.default_rng(9).normal(0.0, 1e-3, r.shape))
    assert found.state is RelationState.FAILS
    assert not found.slips
    assert found.tried > 1000


def test_one_reading_of_nothing_fails_under_its_name() -> None:
    def change(readings: np.ndarray) -> np.ndarray:
        return np.column_stack([readings[:, :5], 0.01 + np.random.default_rng(9).normal(0.0, 1e-3, len(readings))])

    found = _readings(_travel(), change)
    assert found.state is RelationState.FAILS
    assert found.subject == "rho6_mm"


def test_readings_written_down_in_coarse_steps_are_reported() -> None:
    found = _readings(_travel(), lambda r: (r / 7e-4).round() * 7e-4)
    assert found.state is RelationState.FAILS
    assert found.slips[0].kind is SlipKind.ROUNDED
    assert abs(found.slips[0].offset - 0.7) < 1e-6
    assert not _readings(_travel(), lambda r: (r / 1e-5).round() * 1e-5).slips  # a step that hardly shows
    found = _readings(_travel(40), lambda r: (r / 5e-5).round() * 5e-5)
    assert (found.state, found.reason, found.slips[0].kind) == (RelationState.ATTENTION, "rounded", SlipKind.ROUNDED)


def test_readings_of_few_levels_are_recognised_by_their_last_digit() -> None:
    """Levels that are multiples of 0.7 mm have been written to 0.1 mm all the same."""
    levels = np.random.default_rng(6).integers(-2, 3, (40, 6)) * 7e-4
    reached = levels + np.random.default_rng(7).normal(0.0, 3e-5, levels.shape)
    found = _readings(reached, lambda r: (r / 1e-4).round() * 1e-4)
    assert (found.state, found.reason) == (RelationState.ATTENTION, "rounded")
    assert abs(found.slips[0].offset - 0.1) < 1e-9


def test_a_drive_that_is_sent_to_round_numbers_and_reaches_them_wrote_none_down_in_steps() -> None:
    travel = (_travel(40) / 5e-5).round() * 5e-5
    found = _readings(travel, lambda r: (r / 5e-5).round() * 5e-5)
    assert (found.state, found.slips) == (RelationState.OK, ())


def test_evidence_is_the_gaussian_marginal_likelihood() -> None:
    rng = np.random.default_rng(2)
    columns, misfit, level = rng.standard_normal((9, 3)), rng.standard_normal(9), 1.7
    cov = columns @ columns.T + level**2 * np.eye(9)
    wanted = -0.5 * (misfit @ np.linalg.solve(cov, misfit) + np.linalg.slogdet(2.0 * np.pi * cov)[1])
    # with the floor at a level that is above the likeliest, that level is taken
    assert_close(log_evidence(misfit, physics(columns), level), wanted, atol=1e-9)


def test_a_mirrored_flat_body_is_said_to_be_hidden() -> None:
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.3, 1.0, 0.0], [0.4, 0.2, 0.0]])
    is_observed = np.ones((2, 5), bool)
    found = survey_of(BodyPoints("platform", flat * [1.0, 1.0, -1.0], np.stack([flat, flat]), is_observed, 1e-5))
    assert found.state is RelationState.OK
    assert found.hidden[0].kind is SlipKind.MIRRORED


@pytest.mark.parametrize(("step", "state"), [(1e-6, RelationState.FAILS), (1e-3, RelationState.NOT_TESTED)])
def test_equal_points_are_a_copy_only_where_the_file_resolves_the_noise(step: float, state: RelationState) -> None:
    rng = np.random.default_rng(3)
    points = (rng.normal(0.0, 5e-6, (10, 4, 3)) + rng.uniform(0.0, 1.0, (4, 3))) / step
    points[7] = points[2]
    found = copies(points.round() * step, np.ones((10, 4), bool), 5e-6, tuple("abcdefghij"))
    assert found.state is state
    if found.slips:
        assert found.slips[0].subjects == ("c", "h")


def test_two_targets_of_a_body_with_equal_points_in_all_poses_are_copies() -> None:
    points = np.random.default_rng(4).normal(size=(10, 4, 3))
    points[:, 3] = points[:, 1]
    is_observed, poses = np.ones((10, 4), bool), tuple("abcdefghij")
    apart = [("base", "1"), ("base", "2"), ("tool", "1"), ("tool", "2")]
    assert (
        copies(points, is_observed, 5e-6, poses, tuple(apart)).state is RelationState.OK
    )  # one target, listed on two bodies
    same = copies(points, is_observed, 5e-6, poses, tuple(("tool", str(k)) for k in range(1, 5)))
    assert same.state is RelationState.FAILS
    assert same.slips[0].subjects == ("2", "4")
    points[5, 3, 0] += 1e-9
    assert (
        copies(points, is_observed, 5e-6, poses, tuple(("tool", str(k)) for k in range(1, 5))).state is RelationState.OK
    )


def _seen(shift_of: str = "", euler: str = "") -> MeasuredMotion:
    """Poses of a base that turns between poses and of a platform, with one slip: the measurements of a body one row too
    far down, or rotation vectors that are Euler angles."""
    motion, _ = _motion(_travel(30, 4e-2))
    rng = np.random.default_rng(8)
    turned = Rotation.from_rotvec(rng.normal(0.0, 0.4, (30, 3))).as_matrix()
    t = rng.normal(0.0, 0.5, (30, 3))
    place, platform = t + (turned @ motion.p[..., None])[..., 0], turned @ motion.R
    earlier = np.r_[0, np.arange(29)]
    if shift_of == "base":
        turned, t = turned[earlier], t[earlier]
    if shift_of == "platform":
        platform, place = platform[earlier], place[earlier]
    if euler:
        turned, platform = (
            Rotation.from_rotvec(Rotation.from_matrix(own).as_euler(euler)).as_matrix() for own in (turned, platform)
        )
    back = np.swapaxes(turned, -1, -2)
    p = (back @ (place - t)[..., None])[..., 0]
    return replace(motion, p=p, R=back @ platform, base=(t, turned), were_rotations_written=bool(euler))


@pytest.mark.parametrize("body", ["base", "platform"])
def test_measurements_of_one_body_a_row_too_far_down_are_named(body: str) -> None:
    columns = tuple(f"rho{leg}_mm" for leg in range(1, 7))
    found = relations(_seen(body), ReadingNames(columns, tuple(map(str, range(30)))))[-1]
    assert found.state is RelationState.FAILS
    assert [(slip.kind, slip.quantity, slip.shift) for slip in found.slips] == [
        (SlipKind.ROWS_SHIFTED, f"measurements of {body}", 1)
    ]


@pytest.mark.parametrize("order", ["XYZ"])
def test_euler_angles_that_were_read_as_rotation_vectors_are_named(order: str) -> None:
    columns = tuple(f"rho{leg}_mm" for leg in range(1, 7))
    found = relations(_seen(euler=order), ReadingNames(columns, tuple(map(str, range(30)))))[-1]
    assert found.state is RelationState.FAILS
    assert [(slip.kind, slip.subjects) for slip in found.slips] == [(SlipKind.ROTATION, (order,))]
