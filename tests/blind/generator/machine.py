"""The true machine: geometry as built, targets on its bodies, and all positions in each pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.closure import flexed_length, platform_pose
from tests.blind.generator.layout import LEGS, Geometry, Layout, Tolerance
from tests.blind.generator.quaternions import (
    IDENTITY,
    Array,
    compose,
    fit_motion,
    halfway,
    inverse,
    rotate,
    shortest_arc,
    unit,
    with_axis,
)


@dataclass(frozen=True)
class Marks:
    """The targets: body, name, leg whose attachment it sits on (0: none), and true place (M, 3) in the body's
    frame.
    """

    body: tuple[str, ...]
    name: tuple[str, ...]
    on_leg: tuple[int, ...]
    place: Array

    def of(self, body: str) -> Array:
        """Indices of the body's targets."""
        return np.flatnonzero([b == body for b in self.body])

    def index(self, body: str, name: str) -> int:
        """Index of one target."""
        return list(zip(self.body, self.name, strict=True)).index((body, name))

    def framing(self, body: str) -> Array:
        """Indices of the targets that define the body's frame: those that sit on no attachment."""
        return np.flatnonzero([b == body and leg == 0 for b, leg in zip(self.body, self.on_leg, strict=True)])


@dataclass
class Machine:
    """The state of the structure in N poses, which effects may change: joints, legs and marks, mm, pose
    first.

    ``a``, ``u`` in the base frame and ``b`` in the platform frame (N, 6, 3); ``length``, ``drho`` (N, 6);
    ``rho0`` (6,); ``marks`` (N, M, 3) in the frames of their bodies; ``flexure`` length of the flexures that
    shift (6,), 0 where joints are ideal.
    """

    a: Array
    b: Array
    u: Array
    length: Array
    drho: Array
    rho0: Array
    marks: Array
    flexure: Array
    home_height: float


@dataclass(frozen=True)
class BodyPoses:
    """Poses of base, platform and leg1 to leg6: position (N, 8, 3) and quaternion (N, 8, 4) in the base frame."""

    position: Array
    turn: Array


BODIES = ("base", "platform", *(f"leg{i}" for i in range(1, LEGS + 1)))


def build(nominal: Geometry, tolerance: Tolerance, rng: np.random.Generator) -> Geometry:
    """The geometry that was really made: nominal plus a draw from the tolerance."""
    tilt = rng.normal(0.0, tolerance.u, (LEGS, 3)) * [1.0, 1.0, 0.0]
    return replace(
        nominal,
        a=nominal.a + rng.normal(0.0, tolerance.a_mm, (LEGS, 3)),
        b=nominal.b + rng.normal(0.0, tolerance.b_mm, (LEGS, 3)),
        u=unit(nominal.u + tilt),
        length=nominal.length + rng.normal(0.0, tolerance.length_mm, LEGS),
    )


def place_marks(layout: Layout, built: Geometry, rng: np.random.Generator) -> Marks:
    """Targets around the base, over the platform, on the attachments and along the legs."""
    targets, nominal = layout.targets, layout.geometry
    base_radius = np.mean(np.linalg.norm(nominal.a[:, :2], axis=1))
    platform_radius = np.mean(np.linalg.norm(nominal.b[:, :2], axis=1))
    groups = [
        ("base", "B", _ring(targets.base, 1.3 * base_radius, 0.2 * base_radius, rng)),
        ("platform", "P", _ring(targets.platform, 0.8 * platform_radius, 0.25 * platform_radius, rng)),
    ]
    for leg in range(1, len(nominal.a) + 1):
        # Uneven spacing, as a hand sets it: an even one would look the same from either end.
        spots = np.linspace(0.15, 0.85, targets.per_leg) + rng.uniform(-0.05, 0.05, targets.per_leg)
        along = nominal.length[leg - 1] * spots
        groups.append((f"leg{leg}", f"L{leg}", _helix(along, rng)))
    body = [name for name, _, places in groups for _ in places]
    label = [f"{letter}{k:02d}" for _, letter, places in groups for k in range(1, len(places) + 1)]
    seats = list(targets.on_attachments)
    return Marks(
        body=(*body, *["platform"] * len(seats)),
        name=(*label, *(f"A{leg}" for leg in seats)),
        on_leg=(*[0] * len(body), *seats),
        place=np.concatenate([*(places for _, _, places in groups), built.b[np.array(seats, int) - 1]]),
    )


def _ring(count: int, radius: float, height: float, rng: np.random.Generator) -> Array:
    """Places all round a ring, alternately inside and outside it, at heights from 0 to ``height`` (count,
    3).
    """
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) / max(count, 1)
    r = radius * (1 + 0.15 * (-1.0) ** np.arange(count))
    z = height * rng.permutation(count) / max(count - 1, 1)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def _helix(along: Array, rng: np.random.Generator) -> Array:
    """Places on a tube of 8 mm radius at distances ``along`` from its lower end (count, 3)."""
    angle = rng.uniform(0, 2 * np.pi) + 2.4 * np.arange(len(along))
    return np.stack([8 * np.cos(angle), 8 * np.sin(angle), along], axis=1)


def at_reference(built: Geometry, marks: Marks, drho: Array) -> Machine:
    """The machine in N poses with displacements ``drho`` (N, 6) before any effect has touched it."""
    n = len(drho)
    return Machine(
        a=np.tile(built.a, (n, 1, 1)),
        b=np.tile(built.b, (n, 1, 1)),
        u=np.tile(built.u, (n, 1, 1)),
        length=np.tile(built.length, (n, 1)),
        drho=drho,
        rho0=built.rho0,
        marks=np.tile(marks.place, (n, 1, 1)),
        flexure=np.zeros(LEGS),
        home_height=built.home_height,
    )


def shift_attachments(machine: Machine, marks: Marks, shift: Array, follow: float) -> None:
    """Move attachment i by ``shift`` (N, 6) along the platform's z, with the targets on it and, by
    ``follow``, those around.

    What follows is put back into the least-squares frame of the targets that define the platform's frame,
    which is the one that the shift refers to.
    """
    machine.b[:, :, 2] += shift
    for k, leg in enumerate(marks.on_leg):
        if leg:
            machine.marks[:, k, 2] += shift[:, leg - 1]
    framing = marks.framing("platform")
    if follow and len(framing) >= 3:
        away = machine.marks[:, framing]
        near = np.exp(-np.sum((away[:, :, None] - machine.b[:, None]) ** 2, axis=-1) / 60.0**2)
        moved = away.copy()
        moved[:, :, 2] += follow * np.einsum("nki,ni->nk", near / near.sum(axis=-1, keepdims=True), shift)
        turn, position = fit_motion(moved, away)
        machine.marks[:, framing] = rotate(turn[:, None], moved) + position[:, None]


def move_attachments(machine: Machine, marks: Marks, shift: Array) -> None:
    """Move attachment i by ``shift`` (N, L, 3) in the platform's frame, and the targets on it; no other."""
    machine.b += shift
    for k, leg in enumerate(marks.on_leg):
        if leg:
            machine.marks[:, k] += shift[:, leg - 1]


def platform_of(machine: Machine) -> tuple[Array, Array]:
    """Position (N, 3) and quaternion (N, 4) of the platform, whose legs move on fixed lines or change in length."""
    if machine.u.shape[1]:
        return assemble(machine)[:2]
    reach = machine.length + machine.rho0 + machine.drho
    return platform_pose(machine.a, machine.b, reach, machine.home_height)


def assemble(machine: Machine, straight: Array | None = None) -> tuple[Array, Array, Array]:
    """Position (N, 3) and quaternion (N, 4) of the platform, and the leg directions z (N, 6, 3); closes all
    loops.

    ``straight`` (1, 6, 3) are the directions in which the flexures are not bent; without them the joints are
    ideal.
    """
    lower = lower_joints(machine)
    p, q = platform_pose(lower, machine.b, machine.length, machine.home_height)
    z = unit(p[:, None] + rotate(q[:, None], machine.b) - lower)
    if straight is None or not np.any(machine.flexure):
        return p, q, z
    for _ in range(8):  # contracts by a factor of thousands per round
        bent_low = np.sum(z * straight, axis=-1)
        bent_high = np.sum(z * rotate(q[:, None], np.broadcast_to(straight, z.shape)), axis=-1)
        length = flexed_length(machine.length, machine.flexure, bent_low, bent_high)
        p, q = platform_pose(lower, machine.b, length, machine.home_height)
        z = unit(p[:, None] + rotate(q[:, None], machine.b) - lower)
    return p, q, z


def lower_joints(machine: Machine) -> Array:
    """Lower joints (N, 6, 3) in the base frame, mm."""
    return machine.a + (machine.rho0 + machine.drho)[..., None] * machine.u


def stand(machine: Machine, reference: Machine) -> BodyPoses:
    """The frames of all eight bodies in every pose, seen from the reference configuration (a machine of one
    pose).

    A leg's frame has its origin in the lower joint and z along the leg; about its own axis the leg turns half
    as far as the platform's end of it turns against the base's end, as two equal flexures make it.
    """
    _, q0, z0 = assemble(reference)
    p, q, z = assemble(machine, z0)
    z0 = np.broadcast_to(z0, z.shape)
    upright = with_axis(z0)
    below = compose(shortest_arc(z0, z), upright)
    carried = np.broadcast_to(compose(q, inverse(q0))[:, None], upright.shape)
    above = compose(shortest_arc(rotate(carried, z0), z), compose(carried, upright))
    origin, level = np.zeros_like(p)[:, None], np.tile(IDENTITY, (len(p), 1, 1))
    return BodyPoses(
        position=np.concatenate([origin, p[:, None], lower_joints(machine)], axis=1),
        turn=np.concatenate([level, q[:, None], halfway(below, above)], axis=1),
    )


def exact_points(machine: Machine, body_poses: BodyPoses, marks: Marks) -> Array:
    """Exact positions of all marks (N, M, 3), base frame."""
    of_mark = np.array([BODIES.index(body) for body in marks.body])
    return rotate(body_poses.turn[:, of_mark], machine.marks) + body_poses.position[:, of_mark]


def framed_pose(points: Array, marks: Marks) -> tuple[Array, Array]:
    """Position (N, 3) and quaternion (N, 4) of the platform frame in the base frame, as their targets without
    leg define them.
    """
    base, platform = marks.framing("base"), marks.framing("platform")
    base_turn, base_position = fit_motion(np.broadcast_to(marks.place[base], points[:, base].shape), points[:, base])
    turn, position = fit_motion(np.broadcast_to(marks.place[platform], points[:, platform].shape), points[:, platform])
    back = inverse(base_turn)
    return rotate(back, position - base_position), compose(back, turn)
