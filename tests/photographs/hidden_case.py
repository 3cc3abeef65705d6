"""Effects hidden in photographed campaigns: kinds, layouts, and strength."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.blind.generator.folder import truth_path
from tests.blind.generator.layout import Noise, telescope_geometry
from tests.blind.generator.schedule import random_moves
from tests.photographs.hidden import AirGradient, AirLayer, CameraEffect, DrivenCamera, UnstableCamera, WarmBar, Window
from tests.photographs.lens import Lens
from tests.photographs.ray_folder import write_rays
from tests.photographs.rays import BARS, Bar, Shooting, draw_rays
from tests.photographs.stations import Round
from tests.photographs.strength import RayMeasure
from tests.photographs.surveyed import SurveyMeasure

THIRD = Bar("U", ((-290.0, -240.0, 10.0), (-280.0, 210.0, 24.0)))
SECOND = Lens(name="right", focal_px=2310.0, principal_px=-3.1 + 5.2j, radial=(-0.07, 0.09, 0.0))
STILL_MM = 3000.0  # the height at which air over a warm floor has no gradient any more
# Sizes that no room has more of: some twenty kelvins per metre, over a floor as much as in the whole height.
MOST_OF_AIR: dict[type[CameraEffect], float] = {AirGradient: 2.0, AirLayer: 0.8}
Sized = Callable[[float], CameraEffect]


@dataclass(frozen=True)
class Plan:
    """A photographed campaign: fitted and held-out poses, and everything but the effects."""

    kind: str
    poses: tuple[int, int]
    shooting: Shooting


def _plan(kind: str, poses: tuple[int, int], count: int, warmth: float, lenses: tuple[Lens, ...] = (Lens(),)) -> Plan:
    plain = Shooting()
    around = replace(plain.layout.surroundings, temperature_step_c=warmth)
    layout = replace(plain.layout, surroundings=around)
    own = Shooting(layout=layout, lenses=lenses, stations=Round(count=count), bars=(*BARS, THIRD))
    return Plan(kind, poses, own)


def _large() -> Plan:
    """A machine of four metres, whose bodies a tracker surveyed: what light does over such ways shows."""
    plain = _plan("large", (24, 6), 10, 0.5).shooting
    geometry = telescope_geometry(base_radius=1500.0, platform_radius=1400.0, length=2200.0, rho0=60.0)
    layout = replace(plain.layout, geometry=geometry, noise=Noise(point_mm=0.008, actuator_mm=0.002))
    bars = tuple(
        Bar(bar.name, ((6 * x, 6 * y, 6 * z), (6 * u, 6 * v, 6 * w)))
        for bar in plain.bars
        for (x, y, z), (u, v, w) in [bar.ends_mm]
    )
    stations = replace(plain.stations, distance_mm=9300.0, middle_mm=(0.0, 0.0, 1100.0), unsteady_mm=150.0)
    return Plan("large", (24, 6), replace(plain, layout=layout, bars=bars, stations=stations))


LARGE = "large"
LAYOUTS = {
    plan.kind: plan
    for plan in (
        _plan("many-poses", (24, 0), 8, 0.8),
        _plan("held-out", (18, 5), 8, 1.0),
        _plan("two-cameras", (16, 0), 12, 1.0, (Lens(), SECOND)),
        _large(),
    )
}


def _camera(plan: Plan, rng: np.random.Generator) -> Sized:
    """A camera that jumps, drifts, follows the temperature, or is loose."""
    name = str(rng.choice([lens.name for lens in plan.shooting.lenses]))
    own = UnstableCamera(str(rng.choice(["c", "x0", "y0"])), camera=name, seed=int(rng.integers(2**31)))
    form = str(rng.choice(["jump_px", "per_hour_px", "per_k_px", "per_pose_px"]))
    first = int(rng.integers(round(0.3 * plan.poses[0]), round(0.7 * plan.poses[0]) + 1))
    return lambda size: replace(own, **{form: size, "from_pose": first})


def _bar(plan: Plan, rng: np.random.Generator) -> Sized:
    name = str(rng.choice([bar.name for bar in plan.shooting.bars]))
    return lambda size: WarmBar(1e-5 * size, name)


def _refraction(plan: Plan, rng: np.random.Generator) -> Sized:
    """A pane; in a large scene air over a warm or cold floor, which bends rays evenly, or less and less with height."""
    if plan.kind != LARGE:
        return lambda size: Window(10.0 * size, camera=plan.shooting.lenses[0].name)
    way = float(rng.choice([-1.0, 1.0]))
    if rng.uniform() < 0.5:
        return lambda size: AirGradient(1e-5 * way * size)
    return lambda size: AirLayer(1e-5 * way * size, level_mm=STILL_MM)


def _driven(plan: Plan, rng: np.random.Generator) -> Sized:
    name = str(rng.choice([lens.name for lens in plan.shooting.lenses]))
    parameter = str(rng.choice(["c", "x0", "y0"]))
    return lambda size: DrivenCamera(parameter, size, name)


CATALOGUE: dict[str, Callable[[Plan, np.random.Generator], Sized]] = {
    "camera-instability": _camera,
    "scale-bar-temperature": _bar,
    "refraction": _refraction,
}
STRANGE = {"camera-follows-drive": _driven}
KINDS = CATALOGUE | STRANGE


def layouts_for(names: Sequence[str]) -> list[str]:
    """The layouts in which effects of these names can be hidden: one pane stands before one camera; air shows in a
    large scene alone, where nothing may be hidden, too.
    """
    air = "refraction" in names
    return [kind for kind in LAYOUTS if (kind != "two-cameras" or not air) and (kind != LARGE or air or not names)]


def draw_two(rng: np.random.Generator) -> tuple[str, str]:
    """Two kinds at once."""
    first, second = rng.choice(sorted(CATALOGUE), 2, replace=False).tolist()
    return str(first), str(second)


@dataclass(frozen=True)
class PhotographedCase:
    """A campaign with effects in it, each as strong alone as stated."""

    plan: Plan
    seed: int
    effects: tuple[CameraEffect, ...]
    strengths: tuple[float, ...]

    def write(self, folder: Path) -> Path:
        """Writes the campaign under the folder's name, and its truth next to it."""
        own = replace(self.plan.shooting, layout=replace(self.plan.shooting.layout, name=folder.name))
        made = draw_rays(own, moves_of(self.plan, self.seed), [], self.effects, np.random.default_rng(self.seed))
        write_rays(made, folder, self.seed)
        truth = json.loads(truth_path(folder).read_text(encoding="utf-8"))
        truth |= {"layout": self.plan.kind, "strengths": [round(value, 3) for value in self.strengths]}
        truth_path(folder).write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
        return folder


def moves_of(plan: Plan, seed: int) -> list[tuple[int, str, np.ndarray]]:
    """The configurations of a campaign."""
    return random_moves(*plan.poses, np.random.default_rng([seed, 3]))


def hide(names: Sequence[str], kind: str, wanted: float, seed: int) -> PhotographedCase:
    """Effects by their names in ``KINDS``, each of the wanted strength, in a campaign of the layout ``kind``; air is
    no stronger than a room can have it, and its strength stated as what it is then.

    Rays follow effects of cameras, bars, panes and air in proportion, as far as they are small: one size tells all.
    """
    plan, rng = LAYOUTS[kind], np.random.default_rng([seed, 2])
    by_rays = RayMeasure(plan.shooting, moves_of(plan, seed), seed)
    by_survey = SurveyMeasure(plan.shooting, moves_of(plan, seed), seed)
    effects, strengths = [], []
    for name in names:
        of_size = KINDS[name](plan, rng)
        small = of_size(0.1)
        found = (by_survey if isinstance(small, AirGradient) else by_rays).strength(small)
        if found < 1e-6:
            raise ValueError(f"{name} does not show in this campaign")
        size = min(0.1 * wanted / found, MOST_OF_AIR.get(type(small), np.inf))
        effects.append(of_size(size))
        strengths.append(wanted if size == 0.1 * wanted / found else found * size / 0.1)
    return PhotographedCase(plan, seed, tuple(effects), tuple(strengths))
