"""Hidden effects that a plain bundle adjustment leaves out: unstable cameras, expanding scale bars, bent rays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.named_effect import NamedEffect, Parameter
from tests.blind.generator.quaternions import Array, rotate, unit
from tests.blind.generator.schedule import Schedule
from tests.photographs.lens import Lens, View

PER_M = 1e-3  # of a gradient per metre, per millimetre


class CameraEffect(NamedEffect):
    """An effect changes lenses, bars or rays; where it does nothing, they are left as they are."""

    def lens(self, lens: Lens, pose: int, schedule: Schedule) -> Lens:
        """The lens as it is in a pose (number in the schedule's order)."""
        return lens

    def growth(self, bars: tuple[str, ...], schedule: Schedule) -> Array:
        """By which factor each bar's distance is another than calibrated, (poses, bars)."""
        return np.ones((len(schedule.pose), len(bars)))

    def bend(self, seen: Array, view: View) -> Array:
        """Apparent directions of points (..., 3) in the axes of a camera; their length does not count."""
        return seen


@dataclass(frozen=True)
class UnstableCamera(CameraEffect):
    """One of c, x0, y0 (px) is another in each pose: loose (drawn anew per pose), drifting with time, following the
    temperature, or after a jump; all cameras, or the one that is named.
    """

    id = "camera-instability"
    parameter: str = "c"
    per_pose_px: float = 0.0
    per_hour_px: float = 0.0
    per_k_px: float = 0.0
    jump_px: float = 0.0
    from_pose: int = 0  # id of the first pose, in time, after the jump
    camera: str = ""
    seed: int = 0

    @property
    def subject(self) -> str:
        return f"camera {self.camera}".strip() if self.camera else ""

    def parameters(self) -> Mapping[str, Parameter]:
        amounts = {
            f"{self.parameter}_scatter": (self.per_pose_px, "px"),
            f"{self.parameter}_per_h": (self.per_hour_px, "px/h"),
            f"{self.parameter}_per_k": (self.per_k_px, "px/K"),
            self.parameter: (self.jump_px, "px"),
        }
        parameters: dict[str, Parameter] = {name: amount for name, amount in amounts.items() if amount[0]}
        return parameters | ({"from_pose": (self.from_pose, "")} if self.jump_px else {})

    def change_px(self, schedule: Schedule) -> Array:
        """By how much the parameter is off in every pose (N,), px."""
        loose = np.random.default_rng(self.seed).normal(size=len(schedule.pose))
        jumped = np.zeros(len(schedule.pose))
        if self.jump_px:
            jumped = (schedule.time_s >= schedule.time_s[schedule.pose.index(self.from_pose)]).astype(float)
        return (
            self.per_pose_px * loose
            + self.per_hour_px * schedule.time_s / 3600
            + self.per_k_px * schedule.heat
            + self.jump_px * jumped
        )

    def lens(self, lens: Lens, pose: int, schedule: Schedule) -> Lens:
        if self.camera not in ("", lens.name):
            return lens
        change = float(self.change_px(schedule)[pose])
        if self.parameter == "c":
            return replace(lens, focal_px=lens.focal_px + change)
        return replace(lens, principal_px=lens.principal_px + change * {"x0": 1, "y0": 1j}[self.parameter])


@dataclass(frozen=True)
class WarmBar(CameraEffect):
    """A bar (or all of them) grows with the temperature, and its length is stated as a constant."""

    id = "scale-bar-temperature"
    expansion_per_k: float = 23e-6
    bar: str = ""

    @property
    def subject(self) -> str:
        return f"bar {self.bar}" if self.bar else ""

    def parameters(self) -> Mapping[str, Parameter]:
        return {"alpha": (self.expansion_per_k, "1/K")}

    def growth(self, bars: tuple[str, ...], schedule: Schedule) -> Array:
        concerned = np.array([self.bar in ("", bar) for bar in bars], float)
        return 1 + self.expansion_per_k * schedule.heat[:, None] * concerned


@dataclass(frozen=True)
class AirGradient(CameraEffect):
    """The air's refractive index grows evenly along the scene's z: rays are parabolas, bent towards where it is
    larger.
    """

    id = "refraction"
    per_m: float = 2e-5

    def parameters(self) -> Mapping[str, Parameter]:
        return {"gradient": (1e6 * self.per_m, "ppm/m")}

    def bend(self, seen: Array, view: View) -> Array:
        up = rotate(view.turn, np.broadcast_to([0.0, 0.0, 1.0], seen.shape))
        reach = np.linalg.norm(seen, axis=-1, keepdims=True)
        along = seen / reach
        across = up - np.sum(up * along, axis=-1, keepdims=True) * along
        return seen - 0.5 * reach**2 * PER_M * self.per_m * across


@dataclass(frozen=True)
class AirProfile(CameraEffect):
    """The air's refractive index has a curved profile along the scene's z, 1 + curvature z^2 / 2: what changes with
    height is what a network cannot absorb.
    """

    id = "refraction"
    curvature_per_m2: float = 2e-5

    def parameters(self) -> Mapping[str, Parameter]:
        return {"profile_curvature": (1e6 * self.curvature_per_m2, "ppm/m^2")}

    def bend(self, seen: Array, view: View) -> Array:
        up = rotate(view.turn, np.broadcast_to([0.0, 0.0, 1.0], seen.shape))
        reach = np.linalg.norm(seen, axis=-1, keepdims=True)
        along = seen / reach
        rise = np.sum(up * seen, axis=-1, keepdims=True)
        across = up - rise / reach * along
        camera = np.broadcast_to(view.centre[..., 2:], rise.shape)
        # The integral of (way from the point) x (gradient there) along the chord, heights being linear on it.
        height = camera / 3 + (camera + rise) / 6
        return seen - reach**2 * PER_M**2 * self.curvature_per_m2 * height * across


@dataclass(frozen=True)
class Window(CameraEffect):
    """A plane-parallel plate between camera and object shifts rays sideways; it turns with the camera (``normal`` in
    its axes) or stands in the scene (``normal`` there), and where along the way it stands does not matter.
    """

    id = "refraction"
    thickness_mm: float = 10.0
    index: float = 1.52
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    on_camera: bool = True
    camera: str = ""  # of a campaign with one camera, its name

    @property
    def subject(self) -> str:
        return f"camera {self.camera}".strip() if self.camera else ""

    def parameters(self) -> Mapping[str, Parameter]:
        return {"thickness": (self.thickness_mm, "mm"), "index": (self.index, "1")}

    def bend(self, seen: Array, view: View) -> Array:
        normal = np.broadcast_to(unit(np.array(self.normal)), seen.shape)
        if not self.on_camera:
            normal = rotate(view.turn, normal)
        depth = np.sum(seen * normal, axis=-1, keepdims=True)
        normal, depth = np.where(depth < 0, -normal, normal), np.abs(depth)
        sideways = seen - depth * normal
        offset = np.linalg.norm(sideways, axis=-1, keepdims=True)
        slope = offset / depth
        for _ in range(8):  # contracts by thickness over depth
            inside = slope / np.sqrt(self.index**2 * (1 + slope**2) - slope**2)
            slope = (offset - self.thickness_mm * inside) / (depth - self.thickness_mm)
        return depth * (normal + slope * sideways / np.maximum(offset, 1e-300))


@dataclass(frozen=True)
class AirLayer(CameraEffect):
    """The air's refractive index changes with the square of the height above ``level_mm``: a warm or a cold layer."""

    id = "refraction"
    per_m2: float = 5e-6
    level_mm: float = 200.0

    def parameters(self) -> Mapping[str, Parameter]:
        return {"curvature": (1e6 * self.per_m2, "ppm/m^2")}

    def bend(self, seen: Array, view: View) -> Array:
        # Seen along the chord, the ray curves by the index's slope across it; where it arrives, that has turned it.
        up = rotate(view.turn, np.broadcast_to([0.0, 0.0, 1.0], seen.shape))
        reach = np.linalg.norm(seen, axis=-1, keepdims=True)
        along = seen / reach
        rise = np.sum(up * along, axis=-1, keepdims=True)
        across = up - rise * along
        height = view.centre[..., 2:] + rise * reach - self.level_mm
        slope = PER_M**2 * self.per_m2
        return seen - slope * across * (height * reach**2 / 2 - rise * reach**3 / 3)


@dataclass(frozen=True)
class DrivenCamera(CameraEffect):
    """One of c, x0, y0 (px) of a camera follows the first actuator, as cables that pull at it make it do."""

    id = "unexplained"
    parameter: str = "c"
    per_mm_px: float = 0.3
    camera: str = ""

    @property
    def subject(self) -> str:
        return f"camera {self.camera}".strip() if self.camera else ""

    @property
    def drivers(self) -> tuple[str, ...]:
        return ("rho1_mm",)

    def parameters(self) -> Mapping[str, Parameter]:
        return {self.parameter: (self.per_mm_px, "px/mm")}

    def lens(self, lens: Lens, pose: int, schedule: Schedule) -> Lens:
        if self.camera not in ("", lens.name):
            return lens
        change = float(self.per_mm_px * schedule.asked[pose, 0])
        return UnstableCamera(self.parameter, jump_px=change, from_pose=schedule.pose[pose]).lens(lens, pose, schedule)
