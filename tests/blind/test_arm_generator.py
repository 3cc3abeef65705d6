"""The generator of arm campaigns obeys the physics and the campaign format."""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from tests.blind.generator.arms import CAUSES, INSTRUMENTS, LAYOUTS, draw, truth, write
from tests.blind.generator.arms.__main__ import main
from tests.blind.generator.arms.arm import STANDARD_GRAVITY, Arm, Joint, Link, Row, modified, serial
from tests.blind.generator.arms.draw import ArmCampaign, record
from tests.blind.generator.arms.effects import Effect, draw_effect, hide
from tests.blind.generator.arms.geometry import NOTATIONS, Design, Tolerance
from tests.blind.generator.arms.instrument import rows as differences
from tests.blind.generator.arms.instrument import see
from tests.blind.generator.arms.layouts import ROWS, TREES, with_masses, with_other_frames
from tests.blind.generator.arms.motion import at_rest, gravity_torques, places, potential_energy
from tests.blind.generator.arms.notation import mechanism_lines, urdf
from tests.blind.generator.arms.robot import robot_campaign, write_robot
from tests.blind.generator.arms.schedule import approach
from tests.blind.generator.arms.strength import apart, linear_fit, of_scatter, squares_of_scatter
from tests.blind.generator.arms.transforms import Array, any_rotation, roll_pitch_yaw, rotation, small_vector


def _built(name: str) -> Arm:
    rng = np.random.default_rng(sum(map(ord, name)))
    return TREES[name](rng) if name in TREES else serial(ROWS[name](rng))


def _poses(arm: Arm, count: int, seed: int = 3) -> Array:
    low, high = np.array([arm.joints[n].limits for n in arm.actuated]).T
    return low + (high - low) * np.random.default_rng(seed).uniform(size=(count, len(low)))


def _tip(arm: Arm, angles: Array) -> tuple[Array, Array]:
    found = places(arm, at_rest(arm, angles, 0))
    return found.turned[:, arm.tips[0]], found.moved[:, arm.tips[0]]


def _whole(turned: Array, moved: Array) -> Array:
    return np.block([[turned, moved[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


def _by_urdf(text: str, angles: dict[str, float], tip: str) -> Array:
    """Textbook reading of a URDF, from the tip down to the base link."""
    robot, whole, link = ElementTree.fromstring(text), np.eye(4), tip
    while link != "base_link":
        joint = next(j for j in robot.iter("joint") if j.find("child").get("link") == link)
        origin = {key: np.array(text.split(), float) for key, text in joint.find("origin").attrib.items()}
        step = _whole(Rotation.from_euler("xyz", origin["rpy"]).as_matrix(), origin["xyz"])
        if joint.get("type") != "fixed":
            mimic, name = joint.find("mimic"), joint.get("name")
            value = angles[name] if mimic is None else angles[mimic.get("joint")] * float(mimic.get("multiplier"))
            axis = value * np.array(joint.find("axis").get("xyz").split(), float)
            slides = joint.get("type") == "prismatic"
            turn = np.zeros(3) if slides else axis
            step = step @ _whole(Rotation.from_rotvec(turn).as_matrix(), axis - turn)
        whole, link = step @ whole, joint.find("parent").get("link")
    return whole


def _by_rows(table: list[dict[str, float | str]], angles: Array) -> Array:
    """Textbook product of rows of Denavit and Hartenberg."""
    whole = np.eye(4)
    for row, value in zip(table, angles, strict=True):
        theta, alpha = np.radians([float(row["theta_deg"]), float(row["alpha_deg"])])
        d, a = float(row["d_mm"]) / 1e3, float(row["a_mm"]) / 1e3
        theta, d = (theta + value, d) if row["kind"] == "revolute" else (theta, d + value)
        z = _whole(Rotation.from_euler("z", theta).as_matrix(), np.array([0.0, 0.0, d]))
        x = _whole(Rotation.from_euler("x", alpha).as_matrix(), np.array([a, 0.0, 0.0]))
        whole = whole @ (z @ x if row["convention"] == "standard" else x @ z)
    return whole


def _by_screws(mechanism: dict[str, object], angles: Array) -> Array:
    """Textbook product of exponentials."""
    whole = np.eye(4)
    for screw, value in zip(mechanism["screws"], angles, strict=True):
        axis, point = np.array(screw["axis"]), np.array(screw["point_mm"]) / 1e3
        twist = np.zeros((4, 4))
        if screw["kind"] == "revolute":
            twist[:3, :3] = np.cross(np.eye(3), axis)
            twist[:3, 3] = np.cross(point, axis)
        else:
            twist[:3, 3] = axis
        whole = whole @ expm(twist * value)
    home = mechanism["home"]
    turned = Rotation.from_rotvec(home["rotation_rad"]).as_matrix()
    return whole @ _whole(turned, np.array(home["position_mm"]) / 1e3)


def _slides(arm: Arm, turned: Array, moved: Array) -> dict[str, float]:
    """Values of the slides that loops move; the platform has to be level, its rods as long as they are."""
    if arm.loops is None:
        return {}
    assert np.allclose(turned, np.eye(3))
    start = sum((arm.joints[n].origin[:3, 3] for n in arm.passive), np.zeros(3))
    return dict(zip([arm.joints[n].name for n in arm.passive], moved - start, strict=True))


def test_rods_of_a_delta_are_as_long_as_its_description_says() -> None:
    arm = _built("delta")
    found = places(arm, at_rest(arm, _poses(arm, 20), 0))
    for k in (1, 2, 3):
        elbow, ball = (found.moved[:, arm.link(f"{part}_{k}")] for part in ("forearm", "ball"))
        rod = arm.joints[[joint.name for joint in arm.joints].index(f"length_{k}")].origin[:3, 3]
        assert np.allclose(np.linalg.norm(ball - elbow, axis=1), np.linalg.norm(rod), atol=1e-12)


@pytest.mark.parametrize("name", LAYOUTS)
def test_all_notations_of_an_arm_give_the_same_places(name: str) -> None:
    arm = _built(name)
    angles = _poses(arm, 3)
    turned, moved = _tip(arm, angles)
    text = urdf(with_other_frames(arm, np.random.default_rng(1)), name, on_floor=True)
    for n, row in enumerate(angles):
        wanted = _whole(turned[n], moved[n])
        named = dict(zip(arm.names(), row, strict=True)) | _slides(arm, turned[n], moved[n])
        assert np.allclose(_by_urdf(text, named, arm.links[arm.tips[0]].name), wanted, atol=1e-9)
        if name not in ("two-tips", "column-lift", "delta"):
            screws = tomllib.loads("\n".join(mechanism_lines(Design(arm, "screws"))))
            assert np.allclose(_by_screws(screws, row), wanted, atol=1e-8)
        if name in ROWS:
            standard = ROWS[name](np.random.default_rng(sum(map(ord, name))))
            for convention, table in (("standard", standard), ("modified", modified(standard))):
                written = tomllib.loads("\n".join(mechanism_lines(Design(arm, convention, table))))
                assert np.allclose(_by_rows(written["dh"], row), wanted, atol=1e-8)
                assert np.allclose(_tip(serial(table, convention), angles)[1], moved, atol=1e-12)


@pytest.mark.parametrize("name", LAYOUTS)
def test_torque_of_gravity_is_the_slope_of_the_potential_energy(name: str) -> None:
    rng = np.random.default_rng(5)
    arm = _built(name)
    arm = with_other_frames(arm if arm.loops else with_masses(arm, rng), rng)
    arm = replace(arm, payload=2.0, payload_com=np.array([0.05, -0.02, 0.1]), gravity=any_rotation(rng)[0])
    angles, step = _poses(arm, 4), 1e-5
    torques = gravity_torques(arm, places(arm, at_rest(arm, angles, 0)))
    assert np.abs(torques).max() > 1.0
    for k in range(angles.shape[1]):
        way = step * np.eye(angles.shape[1])[k]
        above, below = (potential_energy(arm, places(arm, at_rest(arm, angles + s * way, 0))) for s in (1.0, -1.0))
        assert np.allclose(torques[:, k], -(above - below) / (2.0 * step), atol=1e-5)


def test_elastic_joints_are_in_balance_with_the_loads_of_the_deflected_arm() -> None:
    arm = replace(with_masses(_built("industrial-6r"), np.random.default_rng(2)), payload=5.0)
    angles = _poses(arm, 5)
    soft = 1e-5 * np.array([0.0, 1.0, 2.0, 0.0, 1.0, 0.0])
    found = places(arm, replace(at_rest(arm, angles, 0), compliance=soft))
    rigid = places(arm, at_rest(arm, angles + soft * gravity_torques(arm, found), 0))
    assert np.allclose(found.moved, rigid.moved, atol=1e-12)
    assert np.abs(found.moved - places(arm, at_rest(arm, angles, 0)).moved).max() > 1e-4


def test_a_bent_cantilever_sags_as_in_the_textbook() -> None:
    length, mass, flexibility = 1.2, 3.0, 1e-5
    links = (Link("base_link"), Link("beam"), Link("tool0"))
    reach = np.eye(4)
    reach[0, 3] = length
    joints = (Joint("j1", 0, 1, np.eye(4), source=0), Joint("flange", 1, 2, reach, kind="fixed"))
    arm = Arm(links, joints, (2,), payload=mass)
    state = at_rest(arm, np.array([[0.3]]), 0)
    found = places(arm, replace(state, flexibility=np.array([0.0, flexibility, 0.0])))
    force = mass * STANDARD_GRAVITY
    assert found.moved[0, 2, 2] == pytest.approx(-flexibility * force * length**3 / 3.0, rel=1e-6)
    slope = -found.turned[0, 2, 2, 0]
    assert slope == pytest.approx(flexibility * force * length**2 / 2.0, rel=1e-6)


def test_rotations_agree_with_scipy() -> None:
    rng = np.random.default_rng(1)
    vectors = rng.normal(size=(20, 3)) * rng.choice([1e-9, 1e-3, 1.0], (20, 1))
    assert np.allclose(rotation(vectors), Rotation.from_rotvec(vectors).as_matrix(), atol=1e-15)
    assert np.allclose(small_vector(rotation(vectors * 0.5)), vectors * 0.5, rtol=1e-9, atol=1e-16)
    turned = any_rotation(rng)
    assert np.allclose(Rotation.from_euler("xyz", roll_pitch_yaw(turned)).as_matrix(), turned, atol=1e-14)


@pytest.mark.parametrize("notation", NOTATIONS)
def test_changes_of_the_geometry_are_smooth_and_as_many_as_their_sigmas(notation: str) -> None:
    rows = ROWS["bench-5r"](np.random.default_rng(4))
    rows = modified(rows) if notation == "modified" else rows
    design = Design(serial(rows, notation if notation == "modified" else "standard"), notation, rows)
    sigmas = design.sigmas(Tolerance(1e-3, 1e-3, 1e-3))
    angles = _poses(design.arm, 6)
    way = np.random.default_rng(5).normal(size=len(sigmas))
    (_, nominal), (_, one), (_, two) = (_tip(design.changed(s * sigmas * way), angles) for s in (0.0, 1e-3, 2e-3))
    assert np.allclose(nominal, _tip(design.arm, angles)[1], atol=1e-12)
    assert np.abs(one - nominal).max() > 1e-7
    assert np.allclose(two - nominal, 2.0 * (one - nominal), atol=1e-10)


def test_direction_of_approach_is_that_of_the_last_movement() -> None:
    readings = np.array([[0.0], [0.0], [1.0], [1.0 + 1e-4], [0.5], [0.5 + 4e-3], [2.0]])
    assert approach(readings, np.array([1e-3]))[:, 0].tolist() == [1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0]


def _drawn(cause: str, seed: int = 11) -> ArmCampaign:
    return draw(seed, causes=(cause,), strength=12.0, poses=40)


@pytest.mark.parametrize("cause", CAUSES)
def test_every_cause_is_hidden_at_the_strength_asked_for(cause: str) -> None:
    campaign = _drawn(cause)
    (effect,) = campaign.effects
    assert effect.cause == cause
    if cause == "joints-exchanged":
        assert effect.strength > 12.0
    elif cause == "joint-offset":
        assert campaign.bench.tolerance is None or effect.strength >= 3.0
    else:
        assert effect.strength == pytest.approx(12.0, rel=0.02)
        half = linear_fit(campaign.bench).strength(replace(effect, size=0.5 * effect.size))
        if cause == "approach-scatter":  # its sum of squares alone shows
            fitted = int(np.sum(~campaign.bench.schedule.held_out))
            assert of_scatter((2.0 * half) ** 2, fitted) == pytest.approx(12.0, rel=0.02)
        else:
            assert half == pytest.approx(6.0, rel=0.02)


def test_a_scatter_shows_as_the_likelihood_of_its_mean_square_says() -> None:
    """Twice the difference of log likelihoods at the expected mean square."""
    count, squares = 50, 120.0
    ratio = 1.0 + squares / count
    assert of_scatter(squares, count) ** 2 == pytest.approx(count * (ratio - 1.0 - np.log(ratio)))
    assert squares_of_scatter(of_scatter(squares, count), count) == pytest.approx(squares)


def test_a_notation_changes_no_link() -> None:
    """Growth of a link moves the tip alike in both conventions of rows."""
    rows = ROWS["industrial-6r"](np.random.default_rng(2))
    angles = np.random.default_rng(3).uniform(-1.0, 1.0, (5, 6))
    for link in range(1, 7):
        moved = []
        for arm in (serial(rows), serial(modified(rows), "modified")):
            state = at_rest(arm, angles, 0)
            state.growth[:, link] = 0.01
            moved.append(places(arm, state).moved[:, -1])
        assert np.allclose(*moved, atol=1e-12)


def test_parameters_without_tolerance_absorb_effects() -> None:
    """Without tolerances links are free: so is the place of a tool whose poses are measured."""
    seeds = (seed for seed in range(100) if draw(seed, causes=(), layout="bench-5r", poses=40).bench.tolerance is None)
    bench = draw(next(seeds), causes=(), layout="bench-5r", poses=40).bench
    fit, exact = linear_fit(bench), linear_fit(replace(bench, tolerance=Tolerance(0.0, 1e-9, 1e-9)))
    gain = draw_effect("joint-gain", bench.design.arm, bench.schedule, bench.instrument, np.random.default_rng(1))
    assert all(fit.strength(effect) < 0.999 * exact.strength(effect) for effect in gain)
    bench = draw(5, causes=(), layout="bench-5r", instrument="poses", poses=40).bench
    last = Effect("joint-offset", "", 4, np.ones(40), 1e-4)
    assert linear_fit(replace(bench, tolerance=Tolerance(0.0, 0.0, 0.0))).strength(last) < 0.1


def test_a_joint_without_load_is_never_the_soft_one() -> None:
    """Rounding leaves a trace of torque about a vertical axis, which no compliance of a machine brings to light."""
    for seed in (0, 7):
        campaign = draw(seed, layout="industrial-6r", causes=("joint-compliance",), poses=40)
        (effect,) = campaign.effects
        arm = campaign.bench.design.arm
        found = places(arm, at_rest(arm, campaign.bench.schedule.readings, 0))
        assert effect.size <= 3e-4
        assert np.abs(gravity_torques(arm, found)[:, effect.where]).max() > 0.1


def test_an_offset_never_shows_stronger_than_its_prior_allows() -> None:
    for seed in range(40):
        campaign = draw(seed, causes=("joint-offset",), poses=40)
        if campaign.bench.tolerance is not None:
            break
    (effect,) = campaign.effects
    slide = campaign.bench.joint_kind(effect.where) == "prismatic"
    own = campaign.bench.tolerance.length if slide else campaign.bench.tolerance.offset
    assert 4.0 <= abs(effect.size) / own <= 8.0
    assert effect.strength <= 1.01 * abs(effect.size) / own


def test_a_least_squares_fit_absorbs_what_it_fits() -> None:
    bench = draw(3, layout="bench-5r", instrument="points-campaign", causes=(), poses=40).bench
    fit = linear_fit(bench)
    whole = np.tile(np.array([1e-4, 2e-4, -1e-4, 1e-4, 1e-4, -2e-4]), (40, 1))
    assert fit.strength(Effect("base-jump", "", 0, whole)) < 0.01
    assert fit.displacement(Effect("base-jump", "", 0, whole)) > 1e-4


def _squares_left(campaign: ArmCampaign, effects: Sequence[Effect]) -> tuple[float, int]:
    """Sum of squares that a Gauss-Newton fit of geometry, targets and base leaves, and its degrees of freedom."""
    bench, instrument = campaign.bench, campaign.bench.instrument
    sigmas, count = bench.design.sigmas(bench.tolerance), len(instrument.targets)
    known = np.repeat([1.0 / instrument.noise * target.surveyed for target in instrument.targets], 3)
    prior = np.concatenate([1.0 / sigmas, known, np.zeros(6)])

    def left(found: Array) -> Array:
        geometry, places_, base = np.split(found, [len(sigmas), len(sigmas) + 3 * count])
        own = [
            replace(t, place=p)
            for t, p in zip(instrument.targets, campaign.survey + places_.reshape(-1, 3), strict=True)
        ]
        stood = (instrument.base[0] @ rotation(base[3:]), instrument.base[1] + base[:3])
        arm = bench.design.changed(geometry)
        state = hide(effects, arm, bench.schedule, count)
        seen = see(replace(instrument, targets=tuple(own), base=stood), bench.schedule, arm, state)
        away = differences(instrument, campaign.recorded, seen)[~bench.schedule.held_out]
        return np.concatenate([away.ravel(), -prior * found])

    found, rank = np.zeros(len(prior)), 0
    for _ in range(4):
        now = left(found)
        slope = np.stack([(left(found + step) - now) / 1e-7 for step in 1e-7 * np.eye(len(found))], axis=1)
        change, _, rank, _ = np.linalg.lstsq(-slope, now, rcond=1e-10)
        found = found + change
    return float(np.sum(left(found) ** 2)), np.count_nonzero(now) - int(rank)


def test_a_fit_with_the_truth_leaves_the_noise_and_without_it_the_strength() -> None:
    """Nonlinear fits: with the true effect the sum of squares is that of the noise, without it larger by strength²."""
    campaign = draw(7, layout="bench-5r", notation="urdf", instrument="points-campaign", causes=(), poses=50)
    tolerance = Tolerance(np.radians(0.1), 3e-4, np.radians(0.05))
    bench = replace(campaign.bench, tolerance=tolerance, joint_noise=np.zeros(5))
    effects = draw_effect(
        "joint-harmonic", bench.design.arm, bench.schedule, bench.instrument, np.random.default_rng(1)
    )
    unit = linear_fit(bench).strength(replace(effects[0], size=1e-5)) / 1e-5
    effect = replace(effects[0], size=15.0 / unit)
    campaign = record(7, "bench-5r", bench, [effect], np.random.default_rng(2))
    (within, degrees), (without, _) = _squares_left(campaign, [effect]), _squares_left(campaign, [])
    assert abs(within - degrees) < 3.5 * np.sqrt(2.0 * degrees)
    assert 15.0 - 3.5 < np.sqrt(without - within) < 15.0 + 3.5


def test_the_sample_is_written_again_to_the_byte(tmp_path: Path) -> None:
    folder = write_robot(tmp_path / "robot")
    kept = Path(__file__).parents[2] / "sample_data" / "robot"
    assert {path.name for path in kept.iterdir()} == {path.name for path in folder.iterdir()} | {"README.md"}
    for written in folder.iterdir():
        assert written.read_bytes() == (kept / written.name).read_bytes(), f"{written.name} is out of date"
    now, before = (json.loads(at.with_name("robot.truth.json").read_text(encoding="utf-8")) for at in (folder, kept))
    assert [effect["parameters"] for effect in now["effects"]] == [effect["parameters"] for effect in before["effects"]]


def test_the_sample_hides_two_clear_effects() -> None:
    campaign = robot_campaign()
    assert [(e.cause, e.subject) for e in campaign.effects] == [
        ("joint-compliance", "joint shoulder"),
        ("joint-eccentricity", "joint elbow"),
    ]
    assert min(apart(linear_fit(campaign.bench), campaign.effects)) > 12.0
    assert np.count_nonzero(campaign.bench.schedule.held_out) == 15


def test_exact_effects_are_as_defined() -> None:
    bench = draw(5, layout="scara", causes=(), poses=40).bench
    arm, rng, schedule = bench.design.arm, np.random.default_rng(1), bench.schedule
    assert {e.subject for e in draw_effect("joint-gain", arm, schedule, bench.instrument, rng)} == {
        f"joint {name}" for name in arm.names()
    }
    assert len(draw_effect("joint-eccentricity", arm, schedule, bench.instrument, rng)) == 3  # the slide has none
    gap = replace(draw_effect("joint-backlash", arm, schedule, bench.instrument, rng)[0], size=2e-4)
    state = hide([gap], arm, schedule, len(bench.instrument.targets))
    away = (state.angles - schedule.readings)[:, gap.where]
    assert np.allclose(away, -2e-4 * schedule.approach[:, gap.where])


@pytest.mark.parametrize("kind", INSTRUMENTS)
def test_recorded_values_scatter_by_the_declared_noise(kind: str) -> None:
    campaign = draw(8, instrument=kind, causes=())
    exact = campaign.bench.exact(arm=campaign.arm)
    away = differences(campaign.bench.instrument, campaign.recorded, exact)
    away = away[away != 0.0]
    assert abs(np.sqrt(np.mean(away**2)) - 1.0) < 4.0 / np.sqrt(2.0 * away.size)


def _table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_folders_hold_to_the_campaign_format(layout: str, tmp_path: Path) -> None:
    for number, kind in enumerate(INSTRUMENTS):
        seed = 10 * LAYOUTS.index(layout) + number
        campaign = draw(seed, layout=layout, instrument=kind, causes=(), poses=40)
        folder = write(campaign, tmp_path / kind)
        settings = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
        mechanism = settings["mechanism"]
        assert mechanism["type"] == "chain"
        assert len({"urdf", "dh", "screws"} & set(mechanism)) == 1
        assert settings["measurement"]["frame"] == campaign.bench.instrument.frame
        poses = _table(folder / "configurations.csv")
        assert [int(row["pose"]) for row in poses] == list(range(1, 41))
        assert all(any(f"{name}_{unit}" in poses[0] for unit in ("deg", "rad", "mm")) for name in mechanism["joints"])
        links = {link.name for link in campaign.arm.links}
        measured = _table(folder / f"{kind.partition('-')[0]}.csv")
        assert {int(row["pose"]) for row in measured} == set(range(1, 41))
        assert all(row["body"] in links for row in measured if "body" in row)
        if kind != "poses":
            assert {row["body"] for row in _table(folder / "targets.csv")} <= links
        assert json.loads((tmp_path / f"{kind}.truth.json").read_text(encoding="utf-8")) == json.loads(
            json.dumps(truth(campaign))
        )
        assert not list(folder.glob("*truth*"))


def test_masses_of_the_urdf_are_the_arms(tmp_path: Path) -> None:
    campaign = draw(2, layout="industrial-6r", notation="urdf", causes=("joint-compliance",), poses=40)
    folder = write(campaign, tmp_path / "arm")
    robot = ElementTree.parse(folder / "robot.urdf").getroot()
    heavy = [link for link in robot.iter("link") if len(link)]
    masses = {link.get("name"): float(link.find("inertial/mass").get("value")) for link in heavy}
    assert masses == {link.name: link.mass for link in campaign.arm.links if link.mass}
    assert all(joint.find("limit") is not None for joint in robot.iter("joint") if joint.get("type") != "fixed")


def test_one_seed_gives_one_campaign_and_effects_are_the_only_difference(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        main([str(tmp_path / folder), "--seed", "4", "--count", "2", "--cause", "joint-gain", "--layout", "scara"])
    one, two = (sorted(p for p in (tmp_path / f).rglob("*") if p.is_file()) for f in ("one", "two"))
    assert len(one) >= 8
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in two]
    campaign = draw(4, layout="scara", causes=("joint-gain",))
    without = record(4, "scara", campaign.bench, (), np.random.default_rng(0))
    within = record(4, "scara", campaign.bench, campaign.effects, np.random.default_rng(0))
    change = differences(campaign.bench.instrument, within.recorded, without.recorded)
    assert np.linalg.norm(change) > 0.0
    assert np.array_equal(within.readings, without.readings)


def test_two_effects_at_once_show_next_to_each_other() -> None:
    campaign = draw(6, causes=("joint-eccentricity", "joint-backlash"), poses=60)
    assert [effect.cause for effect in campaign.effects] == ["joint-eccentricity", "joint-backlash"]


def test_foreign_effects_have_the_strength_asked_for() -> None:
    kinds = set()
    for seed in range(8):
        campaign = draw(seed, foreign=True, causes=(), strength=15.0, poses=40)
        kinds |= {effect.fixed["kind"] for effect in campaign.effects}
        assert all(effect.strength >= 14.5 for effect in campaign.effects)
    assert kinds == {"two-joints", "remanence", "slow-base", "heavy-tails"}


def test_a_campaign_that_cannot_be_drawn_is_an_error() -> None:
    with pytest.raises(ValueError, match="expected one of industrial-6r"):
        draw(1, layout="tripod")
    with pytest.raises(ValueError, match="cannot be shown"):
        draw(1, causes=("base-drift",), instrument="points-pose")
    with pytest.raises(ValueError, match="with another cause"):
        draw(1, causes=("joint-gain", "joints-exchanged"))
    with pytest.raises(ValueError, match="a = alpha = 0"):
        modified((Row(0.1, 0.0, 0.0),))
