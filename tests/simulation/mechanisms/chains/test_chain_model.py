"""A chain with unknown base, geometry, joint zeros and targets: derivatives, and recovery of hidden causes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.simulation.mechanisms.chains.made_arms import campaign
from tests.tolerance import assert_close
from truing.estimation.rotation import exp_so3
from truing.inference.observations import Epochs, Frames, Observations
from truing.inference.selection import CauseDiagnosis, CauseSelection, Settings
from truing.inference.verdicts import Reason
from truing.simulation.catalogue import catalogue_of_chains
from truing.simulation.cause import Effect, ReportedParameter
from truing.simulation.inputs import Missing
from truing.simulation.mechanisms.chains.base_drift import BaseDrift
from truing.simulation.mechanisms.chains.causes import (
    ChainCause,
    ChainScene,
    JointBacklash,
    JointCompliance,
    JointGain,
    JointOffset,
    JointScatter,
)
from truing.simulation.mechanisms.chains.conditions import BETWEEN, movements
from truing.simulation.mechanisms.chains.harmonics import JointEccentricity, JointHarmonic, JointPitchError
from truing.simulation.mechanisms.chains.jumps import BaseJump, JointJump, ToolJump
from truing.simulation.mechanisms.chains.link_causes import LinkBending, LinkGrowth
from truing.simulation.mechanisms.chains.loads import ColumnTilt, GravityDirection, JointSag
from truing.simulation.mechanisms.chains.model import ChainModel
from truing.simulation.mechanisms.chains.nonparametric import NonparametricChainEffect
from truing.simulation.mechanisms.chains.settling import SIDE, JointSettling
from truing.simulation.mechanisms.chains.target_causes import ChainTargetMoved
from truing.simulation.mechanisms.chains.tree import JointKind, Tree
from truing.simulation.mechanisms.chains.weight_factors import WeightFactor

NOISE_M, NOISE_RAD = 2e-5, 5e-5

EVERY: tuple[ChainCause, ...] = (
    JointOffset("j2"),
    JointGain("j3"),
    JointBacklash("j2"),
    JointEccentricity("j4"),
    JointHarmonic("j2", order=3),
    JointHarmonic("j4", order=50, beside=0.75, free=True),
    JointPitchError("j3", is_angle=False, order=60, beside=2.0, free=True),
    JointSettling("j3", column="since_motion_s", start_s=2.0, tau_s=9.0),
    JointSettling("j1", form=SIDE, column="time_s", start_s=20.0, tau_s=9.0, free=True),
    JointCompliance("j3", load=20.0),
    JointCompliance("j2", True, 20.0, ("link3 x", "tip z"), (0.2, 0.1), free=True),
    JointSag("j2", parts=("link2 x", "link3 x")),
    GravityDirection("-x", ("j2", "j3"), (True, True), (30.0, 10.0)),
    WeightFactor("j2", factor=0.1, load=20.0, free=True),
    ColumnTilt("base", load=50.0),
    LinkGrowth("link2"),
    LinkBending("link2", load=10.0),
    BaseDrift(span=9.0),
    BaseJump(from_pose=4, from_order=4.0),
    JointJump(from_pose=3, from_order=3.0, joint="j3"),
    ToolJump(from_pose=5, from_order=5.0, link="tip"),
    ChainTargetMoved("tip", "P1", 5, 5.0),
)


@pytest.mark.parametrize("orientation", [False, True])
def test_derivatives_are_those_of_the_channels(orientation: bool) -> None:
    rng = np.random.default_rng(1)
    model = campaign(rng, 10, 2, orientation).with_causes(EVERY)
    own = model.known
    noisy = replace(own, reading_sigma=np.full(5, 1e-4))
    model = replace(model, known=noisy)
    reference = model.tree_frames(np.zeros(model.shared_size), np.zeros((10, 5))).R[:, model.channels.node]
    coupling = np.zeros((10, len(model.channels.names), 3, 3))
    coupling[:, -2] = rng.normal(size=(10, 3, 3)) * orientation
    model = model.at(replace(model.conditions, reference=reference, coupling=coupling))
    shared, local = 0.01 * rng.normal(size=model.shared_size), rng.normal(size=(10, 5))
    found = model.predict(shared, local)
    assert_close(found.values, model.points(shared, local), atol=0)
    for j, step in enumerate(1e-4 * np.eye(model.shared_size)):
        slope = (model.points(shared + step, local) - model.points(shared - step, local)) / 2e-4
        assert_close(found.by_shared[..., j], slope, atol=2e-8)
    for j, step in enumerate(1e-3 * np.eye(5)):
        slope = (model.points(shared, local + step) - model.points(shared, local - step)) / 2e-3
        assert_close(found.by_local[..., j], slope, atol=1e-9)


def test_another_direction_of_gravity_deflects_as_compliance_does_under_it() -> None:
    machine = campaign(np.random.default_rng(1), 20).machine
    other = replace(machine.under(np.array([-1.0, 0.0, 0.0])))
    found = GravityDirection("-x", ("j2", "j3"), (True, True), (30.0, 10.0)).deviations(machine)
    for place, joint in enumerate(("j2", "j3")):
        assert_close(found[..., place], JointCompliance(joint, load=1.0).deviations(other)[..., 0], atol=0)
    assert_close(machine.under(machine.gravity).moment, machine.moment, atol=0)
    tried = {cause.direction: cause.is_opposite for cause in GravityDirection().candidates(ChainScene(machine))}
    assert tried == {"+x": False, "-x": False, "+y": False, "-y": False, "+z": True}, "all but the declared one"


def test_a_wrong_direction_of_gravity_is_named() -> None:
    made = GravityDirection("-x", ("j2",), (True,), (30.0,))
    found = diagnosed([Effect(made, np.array([6e-5]))], 4)
    (cause,) = (v.cause for v in found.verdicts if v.verdict == "found")
    assert isinstance(cause, GravityDirection)
    assert (cause.direction, cause.joints) == ("-x", ("j2",))


def test_a_deflection_that_is_not_in_proportion_to_the_load_is_no_compliance() -> None:
    cubic = {"columns": ("torque_j2_nm",), "half_ranges": (42.0,), "degree": 3, "first": 3}
    stiffening = NonparametricChainEffect(joint="j2", **cubic)
    found = diagnosed([Effect(stiffening, np.array([6e-4]))], 4)
    (cause,) = (v.cause for v in found.verdicts if v.verdict == "found")
    assert (cause.subject, cause.inputs(0)) == ("joint j2", ("torque_j2_nm",))


def test_a_delay_of_a_reading_is_no_backlash_where_the_speed_is_recorded() -> None:
    speeds = {"speed_pct": np.random.default_rng(9).choice([10.0, 20.0, 40.0], 60)}
    late = {"columns": ("speed_pct", "approach_j3"), "centres": (0.0, 0.0), "half_ranges": (40.0, 1.0)}
    effect = Effect(NonparametricChainEffect(joint="j3", **late), np.array([8e-4]))
    found = diagnosed([effect], 4, recorded=speeds)
    (cause,) = (v.cause for v in found.verdicts if v.verdict == "found")
    assert (cause.subject, cause.inputs(0)) == ("joint j3", ("speed_pct", "approach_j3"))
    assert cause.needs(0) == ("speed_pct",), "the direction follows from the readings"


def test_a_joint_that_follows_the_temperature_follows_no_joint_beyond_it() -> None:
    """The tool, which j5 turns, moves by what j4 does: in its frame, residuals without the effect depend on j5."""
    warm = {"columns": ("temperature_c",), "centres": (20.0,), "half_ranges": (2.0,)}
    found = diagnosed([Effect(NonparametricChainEffect(joint="j4", **warm), np.array([1.5e-3]))], 4)
    (cause,) = (v.cause for v in found.verdicts if v.verdict == "found")
    assert (cause.subject, cause.inputs(0)) == ("joint j4", ("temperature_c",))
    assert not found.attributed, "the effect explains all"


@pytest.mark.slow
@pytest.mark.parametrize(("first", "size"), [(1, 8e-4), (-1, 8e-4), (-1, -8e-4)])
def test_the_unknown_direction_of_the_first_pose_bends_no_backlash(first: int, size: float) -> None:
    """The wrong direction is an error of the whole gap in one pose, which a large gap makes many times the noise.

    A gap that a controller compensates too much is negative.
    """
    found = diagnosed([Effect(JointBacklash("j2", first=first), np.array([size]))], 5)
    (verdict,) = (v for v in found.verdicts if v.verdict in ("found", "suspected", "indistinguishable"))
    assert (verdict.verdict, verdict.cause) == ("found", JointBacklash("j2", first=first))
    assert abs(verdict.values[0] - size) < 4.0 * np.sqrt(verdict.covariance[0, 0])


def test_a_scatter_is_an_angle_or_a_length() -> None:
    model = campaign(np.random.default_rng(1), 20)
    nodes = list(model.tree.nodes)
    nodes[2] = replace(nodes[2], kind=JointKind.PRISMATIC)
    known = replace(model.known, reading_sigma=np.full(5, 1e-5))
    scatters = replace(model, tree=Tree(tuple(nodes), model.tree.readings), known=known).scene.scatters(JointScatter())
    units = {scatter.cause.joint: scatter.cause.parameters(0)[0].unit for scatter in scatters}
    assert units == {"j1": "rad", "j2": "mm", "j3": "rad", "j4": "rad", "j5": "rad"}


def diagnosed(
    effects: Sequence[Effect[ChainCause]],
    seed: int,
    orientation: bool = False,
    gears: bool = False,
    described: Callable[[ChainModel], ChainModel] = lambda model: model,
    given: Sequence[ChainCause] = (),
    recorded: Mapping[str, NDArray] | None = None,
) -> CauseDiagnosis:
    """Diagnosis of a campaign whose geometry and zeros are drawn from their tolerances. Orders of ``gears`` are
    searched on request only, because that takes time. The search knows the model as ``described``; ``given`` causes are
    in it from the start. ``recorded``: further columns (B,) of the poses."""
    rng = np.random.default_rng(seed)
    model = campaign(rng, 60, 1 if orientation else 2, orientation)
    covariates = {**model.conditions.covariates, **(recorded or {})}
    model = model.at(replace(model.conditions, covariates=covariates))
    if not gears:
        model = replace(model, known=replace(model.known, gear_orders=dict.fromkeys(model.tree.readings, ())))
    true = model.with_causes([effect.cause for effect in effects])
    shared = rng.normal(size=true.shared_size)
    shared[true.layout["base"]] *= 0.01
    shared[true.layout["shape"]] *= 0.1
    true.set_effects(shared, effects)
    local = np.zeros((60, 0))
    values = true.points(shared, local)
    sigma = np.where(model.channels.is_rotation, NOISE_RAD, NOISE_M)[:, None]
    turned = model.channels.is_rotation
    if turned.any():
        seen = exp_so3(sigma * rng.normal(size=values.shape))[:, turned] @ exp_so3(values[:, turned])
        reference = model.conditions.reference.copy()
        reference[:, turned] = seen
        model = model.at(replace(model.conditions, reference=reference))
        values[:, turned] = 0.0
    values[:, ~turned] += (sigma * rng.normal(size=values.shape))[:, ~turned]
    covariance = np.broadcast_to((sigma**2)[..., None] * np.eye(3), (*values.shape, 3))
    measured = Observations(values, covariance, np.ones(values.shape[:2], bool))
    frames = Frames(np.tile(np.eye(3), (60, 1, 1)), np.zeros((60, 3)), free=False)
    model = described(model)
    epochs = Epochs(measured, model.conditions, frames)
    search = CauseSelection(model, epochs, None, Settings(0.05, 200, 1), given=given)
    return search.run(list(catalogue_of_chains().values()))


def weightless(model: ChainModel) -> ChainModel:
    """The model of a description without masses."""
    tree = replace(model.tree, nodes=tuple(replace(node, mass=0.0) for node in model.tree.nodes))
    return replace(model, tree=tree, conditions=replace(model.conditions, payload_kg=np.zeros(len(model.blocks))))


def without_centres(model: ChainModel) -> ChainModel:
    """The model of a description with masses, and with the centre of none: all are a decimetre or two away."""
    away = np.array([0.0, 0.08, 0.15])
    nodes = tuple(replace(node, com=node.com - away) for node in model.tree.nodes)
    links = tuple(node.link for node in nodes if node.mass > 0.0 or node.link == "tip")
    known = replace(model.known, payload=(6, np.zeros(3)), without_centre=links)
    return replace(model, tree=replace(model.tree, nodes=nodes), known=known)


def assuming_centres(model: ChainModel) -> ChainModel:
    """The same, with the centres taken as known."""
    model = without_centres(model)
    return replace(model, known=replace(model.known, without_centre=()))


def names(diagnosis: CauseDiagnosis) -> list[tuple[str, str]]:
    return [(v.cause.id, v.cause.subject) for v in diagnosis.verdicts if v.verdict == "found"]


def reported(diagnosis: CauseDiagnosis) -> tuple[ReportedParameter, ...]:
    """Parameters of the only cause found."""
    (found,) = (verdict for verdict in diagnosis.verdicts if verdict.verdict == "found")
    return found.cause.reported(found.values, found.covariance, 5)


@pytest.mark.parametrize("orientation", [False, True])
def test_nothing_is_found_in_an_arm_within_its_tolerances(orientation: bool) -> None:
    assert names(diagnosed([], 3, orientation, gears=True)) == []


def test_waits_and_steps_are_those_of_the_movement_before() -> None:
    readings = np.array([[0.0], [0.5], [0.5], [np.nan], [0.2]])
    time = np.array([0.0, 10.0, 25.0, 30.0, 70.0])
    found = movements(readings, {"order": np.arange(5.0), "time_s": time}, np.array([0.1]))
    assert found["last step"][:, 0].tolist() == [0.0, 0.5, 0.5, 0.0, pytest.approx(-0.3)]
    assert found[BETWEEN][:, 0].tolist() == [np.inf, 10.0, 25.0, np.inf, 45.0]
    assert found["approach"][:, 0].tolist() == [1.0, 1.0, 1.0, 1.0, -1.0]


@pytest.mark.slow
def test_a_gear_error_of_any_order_is_found_with_its_order() -> None:
    hidden = Effect(JointHarmonic("j2", order=73.4), np.array([8e-5, -6e-5]))
    diagnosis = diagnosed([hidden], 6, gears=True)
    assert names(diagnosis) == [("joint-harmonic", "joint j2")]
    sine, cosine, order = reported(diagnosis)
    assert abs(order.value - 73.4) < 3.5 * order.sigma < 0.4
    for found, true in zip((sine, cosine), hidden.values, strict=True):
        assert abs(found.value - true) < 3.5 * found.sigma < 1e-4


def test_orders_that_readings_do_not_distinguish_are_reported_to_be_open() -> None:
    model = campaign(np.random.default_rng(2), 80)
    readings = model.conditions.readings.copy()
    readings[:, 1] = np.radians(np.arange(80) % 36 * 10.0)
    model = model.at(replace(model.conditions, readings=readings))
    found = [cause for cause in JointHarmonic().candidates(model.scene) if cause.joint == "j2"]
    assert {cause.order for cause in found} == set(range(2, 19))  # 19 periods per turn are 17
    assert all(cause.aliased and not cause.is_persistent for cause in found)
    once = {cause.joint: cause.aliased for cause in JointEccentricity().candidates(model.scene)}
    assert once == {"j1": False, "j2": True, "j3": False, "j4": False, "j5": False}
    free = [cause for cause in JointHarmonic().candidates(model.scene) if cause.joint == "j4"]
    assert len(free) > 150
    assert not any(cause.aliased for cause in free)


def test_known_orders_of_gears_replace_the_search() -> None:
    model = campaign(np.random.default_rng(2), 80)
    model = replace(model, known=replace(model.known, gear_orders={"j2": (81.5,)}))
    found = [cause for cause in JointHarmonic().candidates(model.scene) if cause.joint == "j2"]
    assert {cause.order for cause in found} == {2, 3, 4, 5, 6, 7, 8, 81.5}
    assert found[-1].refined() == found[-1]


def sliding(readings: NDArray, orders: dict[str, tuple[float, ...]]) -> ChainScene:
    """A scene in which j3 slides with some readings (30,), m."""
    model = campaign(np.random.default_rng(2), 30)
    nodes = [replace(node, kind=JointKind.PRISMATIC) if node.joint == "j3" else node for node in model.tree.nodes]
    conditions = replace(model.conditions, readings=model.conditions.readings.copy())
    conditions.readings[:, 2] = readings
    machine = replace(model.machine, tree=Tree(tuple(nodes), model.tree.readings), conditions=conditions)
    return ChainScene(replace(machine, gear_orders=orders))


def test_periods_of_a_slide_are_known_or_searched_within_its_travel() -> None:
    anywhere = np.random.default_rng(3).uniform(0.0, 0.4, 30)
    known = JointPitchError().candidates(sliding(anywhere, {"j3": (2.0 * np.pi / 0.016,)}))
    assert [(cause.joint, cause.beside, cause.aliased) for cause in known] == [("j3", 0.0, False)]
    assert 2.0 * np.pi / known[0].order == pytest.approx(0.016)
    searched = JointPitchError().candidates(sliding(anywhere, {}))
    periods = np.array([2.0 * np.pi / cause.order for cause in searched])
    travel = np.diff(np.quantile(anywhere, (0.01, 0.99)))[0]
    assert {cause.joint for cause in searched} == {"j3"}
    assert periods.max() == pytest.approx(travel / 2.0)
    assert periods.min() == pytest.approx(travel / 200.0)
    assert all(abs(2.0 * np.pi / 0.016 - searched[k].order) < 0.75 * 2.0 * np.pi / travel for k in [_nearest(periods)])
    even = JointPitchError().candidates(sliding(np.repeat(np.linspace(0.0, 0.4, 10), 3), {}))
    assert even
    assert all(cause.aliased and not cause.is_persistent for cause in even)
    assert not any(cause.joint == "j3" for cause in JointHarmonic().candidates(sliding(anywhere, {})))


def _nearest(periods: NDArray) -> int:
    return int(np.argmin(np.abs(1.0 / periods - 1.0 / 0.016)))


def test_a_period_is_reported_with_the_uncertainty_of_its_wave() -> None:
    cause = JointPitchError("j3", is_angle=False, order=2.0 * np.pi / 0.02, beside=5.0, free=True)
    values, covariance = np.array([3e-6, 4e-6, 0.1]), np.diag([1e-12, 1e-12, 0.04])
    sine, cosine, period = cause.reported(values, covariance, 5)
    assert (sine.value, cosine.value, sine.sigma) == pytest.approx((3e-3, 4e-3, 1e-3))
    assert period.value == pytest.approx(2e3 * np.pi / (2.0 * np.pi / 0.02 + 0.1), rel=1e-4)
    later = cause.reported(values + np.array([0.0, 0.0, 1e-4]), covariance, 5)[2]
    shorter = float(period.value) - float(later.value)
    assert period.sigma == pytest.approx(0.2 * shorter / 1e-4, rel=1e-3)


def test_under_unknown_masses_the_sag_of_a_joint_is_found_with_its_course() -> None:
    soft, rng = Effect(JointCompliance("j2", load=40.0), np.array([8e-6])), np.random.default_rng(5)
    diagnosis = diagnosed([soft], 5, described=weightless)
    assert names(diagnosis) == [("joint-sag", "joint j2")]
    (found,) = (verdict for verdict in diagnosis.verdicts if verdict.verdict == "found")
    true = soft.values[0] * campaign(rng, 60, 2).machine.torque(1)
    sag = found.cause.motion(diagnosis.plain.model.machine, 1) @ found.values
    true, sag = true - true.mean(), sag - sag.mean()  # a constant is the joint's zero
    assert np.sqrt(np.mean(true**2)) > 1e-5
    assert np.sqrt(np.mean((sag - true) ** 2)) < 0.2 * np.sqrt(np.mean(true**2))


@pytest.mark.slow
def test_a_compliance_under_weights_of_unknown_centre_is_right_within_its_uncertainty() -> None:
    soft = Effect(JointCompliance("j2", load=40.0), np.array([3e-5]))
    diagnosis = diagnosed([soft], 5, described=without_centres)
    assert names(diagnosis) == [("joint-compliance", "joint j2")]
    own = next(v for v in diagnosis.verdicts if v.cause.id == "joint-compliance")
    sigma = float(np.sqrt(own.covariance[0, 0]))
    assert abs(own.values[0] - soft.values[0]) < 3.0 * sigma < 1.5 * soft.values[0]
    assert names(diagnosed([soft], 5, described=assuming_centres)) != names(diagnosis)


def test_weights_act_off_their_joints_as_far_as_their_centres_are() -> None:
    model = without_centres(campaign(np.random.default_rng(1), 30))
    (found,) = (cause for cause in JointCompliance().candidates(model.scene) if cause.joint == "j2")
    centre = np.array([0.2, 0.0, 0.0])
    nodes = tuple(replace(node, com=node.com + centre) if node.link == "link3" else node for node in model.tree.nodes)
    away = replace(model, tree=replace(model.tree, nodes=nodes))
    values = np.zeros(1 + len(found.parts))
    values[[0, 1 + found.parts.index("link3 x")]] = 1e-5, 0.2
    known = found.deviation(away.machine, values[:1] * np.ones(1))
    assert_close(found.refined().deviation(model.machine, values), known, atol=1e-12)
    assert not any(cause.parts for cause in JointCompliance().candidates(campaign(np.random.default_rng(1), 30).scene))


def test_a_sag_is_a_candidate_only_under_unknown_masses() -> None:
    model = campaign(np.random.default_rng(1), 30)
    assert not JointSag().candidates(model.scene)
    bare = weightless(model)
    parts = {(cause.joint, len(cause.parts)) for cause in JointSag().candidates(bare.scene)}
    assert {joint for joint, _ in parts} == {"j2", "j3", "j4", "j5"}  # the first axis is vertical
    assert ("j2", 2) in parts  # a link has two directions across the axis
    assert JointSag().missing_input(bare.scene) is None
    blind = replace(bare, known=replace(bare.known, gravity=None))
    assert not JointSag().candidates(blind.scene)
    assert JointSag().missing_input(blind.scene) is Missing.GRAVITY
    assert not ColumnTilt().candidates(bare.scene)
    about = {cause.about for cause in ColumnTilt().candidates(model.scene)}
    assert about == {"", "x", "y"}


def test_settling_needs_waits_that_differ() -> None:
    model = campaign(np.random.default_rng(1), 30)
    assert JointSettling().candidates(model.scene)
    for waits in (np.full(30, 5.0), np.full(30, np.nan)):
        even = replace(model.conditions, covariates={**model.conditions.covariates, "since_motion_s": waits})
        assert not JointSettling().candidates(model.at(even).scene)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "is_offset"),
    [
        (Effect(JointCompliance("j2", load=40.0), np.array([8e-6])), False),
        (Effect(JointOffset("j3"), np.array([3e-3])), True),
    ],
    ids=["compliance", "offset"],
)
def test_a_zero_that_was_named_before_the_search_stays_only_with_a_significant_size(
    hidden: Effect[ChainCause], is_offset: bool
) -> None:
    diagnosis = diagnosed([hidden], 6, given=[JointOffset("j3")])
    offset = next(verdict for verdict in diagnosis.verdicts if verdict.cause.id == "joint-offset")
    assert names(diagnosis) == [(hidden.cause.id, hidden.cause.subject)]
    pull, least = abs(offset.values[0]) / np.sqrt(offset.covariance[0, 0]), 2.84  # of five joints, at p = 0.0225
    if is_offset:
        assert (offset.verdict, offset.reason, offset.candidates) == ("found", None, 5)
        assert abs(offset.values[0] - 3e-3) < 3.5 * np.sqrt(offset.covariance[0, 0])
        assert pull > least
    else:
        assert (offset.verdict, offset.reason) == ("rejected", Reason.DROPPED)
        assert offset.p_value > 0.0225
        assert pull < least
    assert any(cause.id == "joint-offset" for cause in diagnosis.final.causes) is is_offset
    assert any(cause.id == "joint-offset" for cause in diagnosis.plain.causes) is is_offset


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "values"),
    [
        (JointOffset("j3"), [3e-3]),
        (JointGain("j2"), [4e-4]),
        (JointBacklash("j3"), [1.5e-4]),
        (JointEccentricity("j2"), [3e-4, -2e-4]),
        (JointHarmonic("j4", order=3), [2e-4, 2e-4]),
        (JointSettling("j2", column="since_motion_s", start_s=2.0, tau_s=6.0), [4e-4]),
        (JointSettling("j3", form=SIDE, column="since_motion_s", start_s=2.0, tau_s=6.0), [-5e-4]),
        (JointCompliance("j2", load=40.0), [8e-6]),
        (ColumnTilt("base", load=50.0), [4e-6, 1.6e-6]),
        (LinkGrowth("link2"), [4e-5]),
        (BaseJump(from_pose=30, from_order=30.0), [1e-4, 0, 5e-5, 0, 1e-4, 0]),
        (JointJump(from_pose=30, from_order=30.0, joint="j2"), [3e-4]),
        (ToolJump(from_pose=30, from_order=30.0, link="tip"), [2e-4, 0, -2e-4, 1e-3, 0, 0]),
        (ToolJump(from_pose=30, from_order=30.0, link="tip"), [3e-3, -2e-3, 2.5e-2, 0, 0, 0]),  # another tool
    ],
    ids=lambda value: value.id if isinstance(value, ChainCause) else "",
)
def test_a_clear_effect_is_found_named_and_measured(cause: ChainCause, values: list[float]) -> None:
    diagnosis = diagnosed([Effect(cause, np.array(values, float))], 5)
    assert names(diagnosis) == [(cause.id, cause.subject)]
    if isinstance(cause, ColumnTilt):
        tilt, shift = reported(diagnosis)
        assert abs(tilt.value - 4e-6) < 3.5 * tilt.sigma < 2e-6
        assert abs(shift.value - 1.6e-3) < 3.5 * shift.sigma < 1.6e-3
    if isinstance(cause, JointSettling):
        size, tau, wait = reported(diagnosis)
        hidden = values[0] * np.exp((cause.start_s - wait.value) / cause.tau_s)
        assert abs(size.value - hidden) < 3.5 * size.sigma < 0.5 * abs(hidden)
        assert abs(tau.value - cause.tau_s) < 3.5 * tau.sigma < 2.0 * cause.tau_s
