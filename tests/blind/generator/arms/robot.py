"""The sample campaign: a robot of six joints before a laser tracker, its shoulder soft, its elbow eccentric."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.blind.generator.arms.arm import Arm, Link
from tests.blind.generator.arms.draw import ArmCampaign, record
from tests.blind.generator.arms.effects import Effect
from tests.blind.generator.arms.folder import write
from tests.blind.generator.arms.geometry import Design, Tolerance
from tests.blind.generator.arms.instrument import Instrument, Target
from tests.blind.generator.arms.layouts import Tree
from tests.blind.generator.arms.motion import at_rest, places
from tests.blind.generator.arms.schedule import Schedule, approach
from tests.blind.generator.arms.strength import Bench, linear_fit
from tests.blind.generator.arms.transforms import Array, X, Y, Z, rotation
from tests.blind.generator.certificate import certificate_lines

SEED = 20240611
POSES, EVERY = 75, 5  # every fifth pose is held out
COMPLIANCE = 8e-7  # rad/(N m), of the shoulder
SINE, COSINE = 1.5e-4, -0.8e-4  # rad, of the elbow
MASSES = {  # kg, and centre of mass in mm
    "turret": (38.0, (60.0, 10.0, 150.0)),
    "upper_arm": (24.0, (0.0, -30.0, 330.0)),
    "elbow_block": (15.0, (40.0, 20.0, 60.0)),
    "forearm": (9.0, (180.0, 0.0, 0.0)),
    "wrist": (3.5, (20.0, 0.0, 0.0)),
    "tool_flange": (0.9, (25.0, 0.0, 0.0)),
}
REACH_DEG = ((-150, 150), (-45, 75), (-60, 60), (-170, 170), (-100, 100), (-175, 175))
TARGETS_MM = ((70.0, 0.0, 35.0), (-40.0, 65.0, 35.0), (-35.0, -60.0, 75.0))
TRACKER = (rotation(np.array([0.02, -0.015, 2.1])), np.array([3.2, -1.4, -0.35]))


def robot() -> Arm:
    """The nominal robot: 1.6 m of reach, 6 kg on the flange."""
    tree, reach = Tree(), np.radians(REACH_DEG)
    steps = (
        ("turn", "base_link", "turret", (0.0, 0.0, 0.24), Z),
        ("shoulder", "turret", "upper_arm", (0.16, 0.0, 0.25), Y),
        ("elbow", "upper_arm", "elbow_block", (0.0, 0.0, 0.68), Y),
        ("roll", "elbow_block", "forearm", (0.14, 0.0, 0.13), X),
        ("bend", "forearm", "wrist", (0.56, 0.0, 0.0), Y),
        ("twist", "wrist", "tool_flange", (0.09, 0.0, 0.0), X),
    )
    for (name, parent, child, point, axis), (low, high) in zip(steps, reach, strict=True):
        tree.add(name, parent, child, point, axis, (round(float(low), 6), round(float(high), 6)))
    tree.add("flange", "tool_flange", "tool0", (0.03, 0.0, 0.0), turned=rotation(np.array([0.0, np.pi / 2.0, 0.0])))
    links = [Link(link.name, *_mass(link.name)) for link in tree.links]
    return replace(tree.arm("tool0"), links=tuple(links), payload=6.0, payload_com=np.array([0.0, 0.02, 0.08]))


def _mass(link: str) -> tuple[float, Array]:
    mass, centre = MASSES.get(link, (0.0, (0.0, 0.0, 0.0)))
    return mass, np.array(centre) / 1e3


def _schedule(arm: Arm, sigma: Array, rng: np.random.Generator) -> Schedule:
    """Poses at random with the tool above 0.4 m and 0.6 m from the first axis, half a minute each."""
    low, high = np.array([joint.limits for joint in arm.joints[:6]]).T
    readings = low + (high - low) * rng.uniform(0.05, 0.95, (20 * POSES, 6))
    tool = places(arm, at_rest(arm, readings, 0)).moved[:, arm.tips[0]]
    readings = readings[(tool[:, 2] > 0.4) & (np.hypot(tool[:, 0], tool[:, 1]) > 0.6)][:POSES]
    time = np.cumsum(rng.uniform(25.0, 40.0, POSES))
    time -= time[0]
    warmth = 0.4 + 0.5 * np.sin(time / 900.0) + rng.normal(0.0, 0.03, POSES)
    held = np.arange(POSES) % EVERY == EVERY - 1
    return Schedule(readings, time, warmth, held, np.zeros(POSES, np.int64), approach(readings, sigma))


def robot_campaign(seed: int = SEED) -> ArmCampaign:
    """The sample campaign in memory."""
    rng, arm = np.random.default_rng(seed), robot()
    sigma = np.full(6, np.radians(2e-4))
    schedule = _schedule(arm, sigma, rng)
    targets = tuple(Target(f"T{n + 1}", arm.tips[0], np.array(p) / 1e3, True) for n, p in enumerate(TARGETS_MM))
    base = (TRACKER[0][None], TRACKER[1][None])
    is_observed = np.ones((POSES, len(targets)), bool)
    tracker = Instrument("points", "campaign", targets, 1e-5, 0.0, base, np.zeros((0, 3)), is_observed)
    tolerance = Tolerance(float(np.radians(0.05)), 3e-4, float(np.radians(0.03)))
    bench = Bench(Design(arm, "urdf"), tolerance, schedule, tracker, sigma)
    return record(seed, "robot", bench, _hidden(bench), rng)


def other_poses(campaign: ArmCampaign, seed: int) -> tuple[Array, Array]:
    """Exact readings (N, 6), rad, of another series of the sample, and the exact places (N, T, 3) of its targets, m."""
    own = campaign.bench
    schedule = _schedule(own.design.arm, own.joint_noise, np.random.default_rng(seed))
    bench = replace(own, schedule=schedule)
    return schedule.readings, bench.exact(_hidden(bench), arm=campaign.arm).points


def _hidden(bench: Bench) -> list[Effect]:
    size, phase = float(np.hypot(SINE, COSINE)), float(np.arctan2(COSINE, SINE))
    angle = bench.schedule.readings[:, 2]
    fixed: dict[str, float | str] = {"order": 1.0, "phase": phase}
    effects = [
        Effect("joint-compliance", "joint shoulder", 1, np.zeros(0), COMPLIANCE),
        Effect("joint-eccentricity", "joint elbow", 2, np.sin(angle + phase), size, fixed),
    ]
    fit = linear_fit(bench)
    return [replace(effect, strength=fit.strength(effect)) for effect in effects]


def write_robot(folder: Path) -> Path:
    """Writes the sample campaign into ``folder``; the same bytes every time."""
    reported = certificate_lines("robot, simulated", "laser tracker, simulated", "2026-11-23", "2026-11-23")
    return write(robot_campaign(), folder, "robot", reported)
