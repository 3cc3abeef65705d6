"""Hidden effects that a plain simulation leaves out: one class each, at the step of the chain where it acts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tests.blind.generator.machine import (
    BODIES,
    BodyPoses,
    Machine,
    Marks,
    lower_joints,
    move_attachments,
    platform_of,
    shift_attachments,
)
from tests.blind.generator.named_effect import NamedEffect, Parameter
from tests.blind.generator.quaternions import Array, inverse, rotate, unit
from tests.blind.generator.schedule import Schedule


@dataclass(frozen=True)
class Setting:
    """Inputs of an effect: schedule, marks, share by which the platform follows, and declared noise of the
    actuators."""

    schedule: Schedule
    marks: Marks
    follow: float
    actuator_mm: float


class Effect(NamedEffect):
    """An effect changes the chain at one or more of its steps; where it does nothing, the step is left as it
    is.
    """

    def drive(self, drho: Array, setting: Setting) -> Array:
        """True displacements (N, 6) of the actuators from those that they indicate, mm."""
        return drho

    def structure(self, machine: Machine, setting: Setting) -> None:
        """Changes joints, legs and marks."""

    def instrument(self, points: Array, body_poses: BodyPoses, setting: Setting) -> Array:
        """Points (N, M, 3) as they are recorded, from those that are there; base frame."""
        return points

    def drawn(self, poses: Array) -> int:
        """Return the count of numbers that the effect draws anew in the poses of a mask (N,): 0 unless its mean motion
        is 0."""
        return 0


def _per_leg(name: str, legs: tuple[int, ...], values: Array, unit: str) -> dict[str, Parameter]:
    return {f"{name}_{leg}": (float(values[leg - 1]), unit) for leg in legs}


@dataclass(frozen=True)
class PerLeg(Effect):
    """An effect with one number per leg: ``amount`` (L,), zero where a leg is spared."""

    amount: Array

    @property
    def legs(self) -> tuple[int, ...]:
        return tuple((np.flatnonzero(self.amount) + 1).tolist())

    @property
    def subject(self) -> str:
        return "" if np.all(self.amount) else " ".join(f"leg{leg}" for leg in self.legs)


class LinearDeformation(PerLeg):
    """Attachment i shifts along the platform's z by kappa_i times the displacement of its actuator."""

    id = "platform-deformation-linear"

    def parameters(self) -> Mapping[str, Parameter]:
        return _per_leg("kappa", self.legs, self.amount, "1")

    def structure(self, machine: Machine, setting: Setting) -> None:
        shift_attachments(machine, setting.marks, self.amount * machine.drho, setting.follow)


@dataclass(frozen=True)
class MatrixDeformation(Effect):
    """The attachments shift along the platform's z by K (L, L) times the displacements of all actuators."""

    K: Array
    id = "platform-deformation-matrix"

    def parameters(self) -> Mapping[str, Parameter]:
        return {f"K{i + 1}{j + 1}": (float(value), "1") for (i, j), value in np.ndenumerate(self.K)}

    def structure(self, machine: Machine, setting: Setting) -> None:
        shift_attachments(machine, setting.marks, machine.drho @ self.K.T, setting.follow)


@dataclass(frozen=True)
class NonlinearDeformation(PerLeg):
    """As the linear one, plus a quadratic (1/mm) and a cubic (1/mm^2) term (6,) each."""

    quadratic: Array
    cubic: Array
    id = "platform-deformation-nonlinear"

    def parameters(self) -> Mapping[str, Parameter]:
        return {
            **_per_leg("kappa", self.legs, self.amount, "1"),
            **_per_leg("quadratic", self.legs, self.quadratic, "1/mm"),
            **_per_leg("cubic", self.legs, self.cubic, "1/mm^2"),
        }

    def structure(self, machine: Machine, setting: Setting) -> None:
        d = machine.drho
        shift = self.amount * d + self.quadratic * d**2 + self.cubic * d**3
        shift_attachments(machine, setting.marks, shift, setting.follow)


@dataclass(frozen=True)
class InPlaneDeformation(Effect):
    """Attachment i shifts along the platform's x and y by ``along_x`` and ``along_y`` (L,) times the displacement of
    its actuator; zero where a leg is spared."""

    along_x: Array
    along_y: Array
    id = "in-plane-deformation"

    @property
    def subject(self) -> str:
        own = np.flatnonzero((self.along_x != 0) | (self.along_y != 0)) + 1
        return "" if len(own) == len(self.along_x) else " ".join(f"leg{leg}" for leg in own)

    def parameters(self) -> Mapping[str, Parameter]:
        legs = tuple((np.flatnonzero((self.along_x != 0) | (self.along_y != 0)) + 1).tolist())
        return _per_leg("kappa_x", legs, self.along_x, "1") | _per_leg("kappa_y", legs, self.along_y, "1")

    def structure(self, machine: Machine, setting: Setting) -> None:
        across = np.stack([self.along_x, self.along_y, np.zeros(len(self.along_x))], -1)
        move_attachments(machine, setting.marks, machine.drho[..., None] * across)


@dataclass(frozen=True)
class ThermalExpansion(Effect):
    """Base and platform grow about their origins and the legs in length; targets are carried along."""

    alpha_base: float
    alpha_platform: float
    alpha_legs: float
    id = "thermal-expansion"

    def parameters(self) -> Mapping[str, Parameter]:
        if self.alpha_base == self.alpha_platform == self.alpha_legs:
            return {"alpha": (self.alpha_base, "1/K")}
        return {
            "alpha_base": (self.alpha_base, "1/K"),
            "alpha_platform": (self.alpha_platform, "1/K"),
            "alpha_legs": (self.alpha_legs, "1/K"),
        }

    def structure(self, machine: Machine, setting: Setting) -> None:
        heat = setting.schedule.heat[:, None, None]
        machine.a *= 1 + self.alpha_base * heat
        machine.b *= 1 + self.alpha_platform * heat
        machine.length *= 1 + self.alpha_legs * heat[..., 0]
        kinds = {"base": self.alpha_base, "platform": self.alpha_platform}
        alpha = np.array([kinds.get(body, self.alpha_legs) for body in setting.marks.body])
        machine.marks *= 1 + alpha[:, None] * heat


@dataclass(frozen=True)
class LegThermal(PerLeg):
    """Legs grow with temperature by ``amount`` (1/K), tube and targets on it, while the bodies do not."""

    id = "leg-thermal"

    def parameters(self) -> Mapping[str, Parameter]:
        if np.all(self.amount == self.amount[0]):
            return {"alpha": (float(self.amount[0]), "1/K")}
        return _per_leg("alpha", self.legs, self.amount, "1/K")

    def structure(self, machine: Machine, setting: Setting) -> None:
        grown = 1 + setting.schedule.heat[:, None] * self.amount
        machine.length *= grown
        for leg in self.legs:
            own = setting.marks.of(f"leg{leg}")
            machine.marks[:, own] *= grown[:, leg - 1, None, None]


@dataclass(frozen=True)
class LegCompliance(PerLeg):
    """Legs give way by ``amount`` (mm/N, L) times the force that pulls at them, of masses (N,) in kg that hang on them
    with their centre (3,) in the platform frame, mm; ``up`` in the base frame."""

    masses: Array
    centre: Array
    up: Array

    id = "leg-compliance"

    def parameters(self) -> Mapping[str, Parameter]:
        if np.all(self.amount == self.amount[0]):
            return {"compliance": (1e3 * float(self.amount[0]), "um/N")}
        return _per_leg("compliance", self.legs, 1e3 * self.amount, "um/N")

    def structure(self, machine: Machine, setting: Setting) -> None:
        free = machine.length.copy()
        for _ in range(3):  # what legs give way turns the platform by next to nothing
            machine.length = free + self.amount * self._pull(machine)
        if not np.all(np.isfinite(machine.length)):
            raise ValueError("the legs do not hold the platform")

    def _pull(self, machine: Machine) -> Array:
        """Force (N, L), N, that pulls at each leg: all of them together hold the masses against gravity."""
        position, turn = platform_of(machine)
        arms = rotate(turn[:, None], machine.b)
        lower = lower_joints(machine) if machine.u.shape[1] else machine.a
        along = unit(position[:, None] + arms - lower)
        by_legs = np.concatenate([-along, np.cross(arms, -along)], -1)  # a leg under tension pulls the platform down
        gravity = -9.80665 * self.masses[:, None] * self.up
        centre = rotate(turn, np.broadcast_to(self.centre, position.shape))
        by_masses = np.concatenate([gravity, np.cross(centre, gravity)], -1)
        return np.linalg.solve(np.swapaxes(by_legs, 1, 2), -by_masses[..., None])[..., 0]


@dataclass(frozen=True)
class GravitySag(Effect):
    """Targets on the platform hang by ``sags`` (mm, by name) along gravity in its frame, from where they sit where the
    platform is level; ``up`` in the base frame."""

    sags: tuple[tuple[str, float], ...]
    up: Array

    id = "gravity-sag"

    @property
    def subject(self) -> str:
        return "platform" if len(self.sags) > 1 else f"target {self.sags[0][0]}"

    def parameters(self) -> Mapping[str, Parameter]:
        return {f"{name}_sag": (sag, "mm") for name, sag in self.sags}

    def structure(self, machine: Machine, setting: Setting) -> None:
        _, turn = platform_of(machine)
        down = -rotate(inverse(turn), np.broadcast_to(self.up, (len(turn), 3)))
        for name, sag in self.sags:
            machine.marks[:, setting.marks.index("platform", name)] += sag * (down + self.up)


@dataclass(frozen=True)
class BaseDeformation(Effect):
    """Base targets and joints shift along z in a saddle or a bowl that follows the temperature or one
    actuator.
    """

    driver: str  # "temperature" or "rho1" .. "rho6"
    saddle_x: float
    saddle_y: float
    bowl: float
    id = "base-deformation"

    def parameters(self) -> Mapping[str, Parameter]:
        unit = "mm/K" if self.driver == "temperature" else "mm/mm"
        return {
            "driver": (self.driver, ""),
            "saddle_x": (self.saddle_x, unit),
            "saddle_y": (self.saddle_y, unit),
            "bowl": (self.bowl, unit),
        }

    def structure(self, machine: Machine, setting: Setting) -> None:
        q = setting.schedule.heat if self.driver == "temperature" else machine.drho[:, int(self.driver[-1]) - 1]
        radius = np.mean(np.linalg.norm(machine.a[..., :2], axis=-1))
        base = setting.marks.of("base")
        machine.marks[:, base, 2] += q[:, None] * self._shape(machine.marks[:, base], radius)
        machine.a[..., 2] += q[:, None] * self._shape(machine.a, radius)

    def _shape(self, place: Array, radius: float) -> Array:
        x, y = place[..., 0] / radius, place[..., 1] / radius
        return self.saddle_x * (x**2 - y**2) + self.saddle_y * 2 * x * y + self.bowl * (x**2 + y**2)


class ActuatorGain(PerLeg):
    """The actuator goes (1 + gain) times as far as it indicates."""

    id = "actuator-gain"

    def parameters(self) -> Mapping[str, Parameter]:
        return _per_leg("gain", self.legs, self.amount, "1")

    def drive(self, drho: Array, setting: Setting) -> Array:
        return drho * (1 + self.amount)


class Backlash(PerLeg):
    """The actuator stays behind by half the gap, against the direction from which it came."""

    id = "actuator-backlash"

    def parameters(self) -> Mapping[str, Parameter]:
        return _per_leg("backlash", self.legs, self.amount, "mm")

    def drive(self, drho: Array, setting: Setting) -> Array:
        return drho - self.amount * approach(drho, setting.schedule, 5 * setting.actuator_mm)


def approach(drho: Array, schedule: Schedule, least: float) -> Array:
    """Direction (N, 6) of each actuator's last movement larger than ``least`` (mm), in time order; +1 before
    any.
    """
    in_time = np.argsort(schedule.time_s)
    direction = np.ones_like(drho)
    for before, now in pairwise(in_time):
        step = drho[now] - drho[before]
        direction[now] = np.where(np.abs(step) > least, np.sign(step), direction[before])
    return direction


@dataclass(frozen=True)
class PeriodicError(PerLeg):
    """The leadscrew adds a sine of its own pitch (mm) to every displacement; ``phase`` (6,) in rad."""

    pitch: float
    phase: Array
    id = "actuator-periodic-error"

    def parameters(self) -> Mapping[str, Parameter]:
        return {
            **_per_leg("amplitude", self.legs, self.amount, "mm"),
            "pitch": (self.pitch, "mm"),
            **_per_leg("phase", self.legs, self.phase, "rad"),
        }

    def drive(self, drho: Array, setting: Setting) -> Array:
        return drho + self.amount * np.sin(2 * np.pi * drho / self.pitch + self.phase)


@dataclass(frozen=True)
class ApproachScatter(Effect):
    """Actuators land elsewhere than they indicate by ``scatter_mm`` (one sigma) times draws (N, L), zero where they
    land as they should. ``subject`` and ``reported`` (further parameters) say where they do not.
    """

    scatter_mm: float
    draws: Array
    subject: str = ""
    reported: tuple[tuple[str, int], ...] = ()
    id = "approach-scatter"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"scatter": (self.scatter_mm, "mm"), **{name: (value, "") for name, value in self.reported}}

    def drive(self, drho: Array, setting: Setting) -> Array:
        return drho + self.scatter_mm * self.draws

    def drawn(self, poses: Array) -> int:
        return int(np.count_nonzero(self.draws[poses]))


@dataclass(frozen=True)
class NoiseBurst(Effect):
    """The noise of all points is ``times`` the instrument's in the poses ``own`` (N,), which follow each other."""

    times: float
    own: Array
    reported: tuple[tuple[str, int], ...] = ()
    id = "noise-burst"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"noise_ratio": (self.times, "1"), **{name: (value, "") for name, value in self.reported}}

    def scatter(self, scatter: Array, setting: Setting) -> Array:
        return scatter * np.where(self.own, self.times, 1.0)[:, None]


@dataclass(frozen=True)
class LegDrift(PerLeg):
    """A leg's effective length drifts over the campaign by ``amount`` (mm), evenly or with a time constant
    ``tau`` (s).
    """

    tau: float | None = None
    id = "leg-drift"

    def parameters(self) -> Mapping[str, Parameter]:
        settling = {} if self.tau is None else {"tau": (self.tau, "s")}
        return {**_per_leg("drift", self.legs, self.amount, "mm"), **settling}

    def structure(self, machine: Machine, setting: Setting) -> None:
        t = setting.schedule.time_s - setting.schedule.time_s.min()
        grown = t if self.tau is None else 1 - np.exp(-t / self.tau)
        machine.length += (grown / grown.max())[:, None] * self.amount


@dataclass(frozen=True)
class ActuatorZeroShift(PerLeg):
    """From one pose on, actuators are ``amount`` (mm) further than they read."""

    from_pose: int
    id = "actuator-zero-shift"

    def parameters(self) -> Mapping[str, Parameter]:
        return {**_per_leg("shift", self.legs, self.amount, "mm"), "from_pose": (self.from_pose, "")}

    def drive(self, drho: Array, setting: Setting) -> Array:
        rank = setting.schedule.rank
        late = rank >= rank[setting.schedule.pose.index(self.from_pose)]
        return drho + late[:, None] * self.amount


@dataclass(frozen=True)
class FlexureShift(Effect):
    """The flexures at both ends of every leg bend as beams instead of turning as ideal joints."""

    flexure_length: float
    id = "flexure-shift"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"flexure_length": (self.flexure_length, "mm")}

    def structure(self, machine: Machine, setting: Setting) -> None:
        machine.flexure = np.full(6, self.flexure_length)


@dataclass(frozen=True)
class MeasurementScale(Effect):
    """The scale bar is wrong by ``scale``, and by ``scale_per_k`` more for every degree."""

    scale: float = 0.0
    scale_per_k: float = 0.0
    id = "measurement-scale"

    def parameters(self) -> Mapping[str, Parameter]:
        named = {"scale": (self.scale, "1"), "scale_per_k": (self.scale_per_k, "1/K")}
        return {name: parameter for name, parameter in named.items() if parameter[0] != 0.0}

    def instrument(self, points: Array, body_poses: BodyPoses, setting: Setting) -> Array:
        return points * (1 + self.scale + self.scale_per_k * setting.schedule.heat[:, None, None])


@dataclass(frozen=True)
class TargetMoved(Effect):
    """A target sits elsewhere, by ``shift`` (mm, body frame), from the pose ``from_pose`` on in time."""

    body: str
    target: str
    shift: tuple[float, float, float]
    from_pose: int
    id = "target-moved"

    @property
    def subject(self) -> str:
        return f"target {self.target}"

    def parameters(self) -> Mapping[str, Parameter]:
        moved = {f"d{axis}": (value, "mm") for axis, value in zip("xyz", self.shift, strict=True)}
        return {**moved, "from_pose": (self.from_pose, "")}

    def instrument(self, points: Array, body_poses: BodyPoses, setting: Setting) -> Array:
        rank = setting.schedule.rank
        late = rank >= rank[setting.schedule.pose.index(self.from_pose)]
        turn = body_poses.turn[late, BODIES.index(self.body)]
        moved = points.copy()
        moved[late, setting.marks.index(self.body, self.target)] += rotate(turn, np.array(self.shift))
        return moved


@dataclass(frozen=True)
class BodyJump(Effect):
    """All targets of a body are displaced together, by ``shift`` (mm) and ``turn`` (rad) about their centroid in the
    body's frame, from the pose ``from_pose`` on in time.
    """

    body: str
    shift: tuple[float, float, float]
    turn: tuple[float, float, float]
    from_pose: int
    id = "body-jump"

    @property
    def subject(self) -> str:
        return self.body

    def parameters(self) -> Mapping[str, Parameter]:
        shift = {f"shift_{axis}": (value, "mm") for axis, value in zip("xyz", self.shift, strict=True)}
        turn = {f"turn_{axis}": (value, "rad") for axis, value in zip("xyz", self.turn, strict=True)}
        return {**shift, **turn, "from_pose": (self.from_pose, "")}

    def instrument(self, points: Array, body_poses: BodyPoses, setting: Setting) -> Array:
        rank = setting.schedule.rank
        late = rank >= rank[setting.schedule.pose.index(self.from_pose)]
        turned = body_poses.turn[late, BODIES.index(self.body)]
        own = list(setting.marks.of(self.body))
        arms = setting.marks.place[own] - setting.marks.place[own].mean(axis=0)
        moved = points.copy()
        for k, arm in zip(own, arms, strict=True):
            moved[late, k] += rotate(turned, np.array(self.shift) + np.cross(np.array(self.turn), arm))
        return moved


@dataclass(frozen=True)
class TargetsSwapped(Effect):
    """Two labels of a body are exchanged in some poses."""

    body: str
    targets: tuple[str, str]
    poses: tuple[int, ...]
    id = "targets-swapped"

    @property
    def subject(self) -> str:
        return f"targets {' '.join(self.targets)}"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"poses": (" ".join(str(pose) for pose in self.poses), "")}

    def instrument(self, points: Array, body_poses: BodyPoses, setting: Setting) -> Array:
        rows = np.isin(setting.schedule.pose, self.poses)
        first, second = (setting.marks.index(self.body, target) for target in self.targets)
        swapped = points.copy()
        swapped[rows, first], swapped[rows, second] = points[rows, second], points[rows, first]
        return swapped
