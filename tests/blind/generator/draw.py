"""Layouts drawn at random: the settings of a campaign before effects are hidden in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.blind.generator.campaign import Campaign, Move, draw_campaign
from tests.blind.generator.effects import Effect
from tests.blind.generator.hexapod import Place, draw_hexapod, hexapod_geometry, random_places
from tests.blind.generator.layout import (
    DataFaults,
    Layout,
    Noise,
    Surroundings,
    Targets,
    Weight,
    noiseless,
    telescope_geometry,
)
from tests.blind.generator.schedule import STROKE_MM, at_rest, even_moves, published_moves, random_moves

WRONG = 0.1  # by so much declared noise is off, in the layouts where it is
WEIGHT_IS_STATED = 0.3  # of campaigns that need no weight
WIDE_MM = 4.0  # stroke where flexures are to bend visibly


@dataclass(frozen=True)
class Plan:
    """Everything about a campaign but the effects: the layout, what is asked of the machine, and the seed."""

    kind: str
    layout: Layout
    asked: Sequence[Move] | Sequence[Place]
    seed: int

    def campaign(self, effects: Sequence[Effect] = (), *, exact: bool = False) -> Campaign:
        """The campaign with effects in it; the same draws whatever they are, and without any noise where exact."""
        layout = self.layout
        if exact:
            layout = replace(layout, noise=noiseless(layout.noise), faults=DataFaults(0.0, 0.0))
        chain: Callable[..., Campaign] = draw_hexapod if layout.geometry.mechanism == "ups" else draw_campaign
        return chain(layout, self.asked, effects, np.random.default_rng(self.seed))


def _telescope(rng: np.random.Generator) -> Layout:
    return Layout(name="telescope")


def _noisy(rng: np.random.Generator) -> Layout:
    faults = DataFaults(missing_share=rng.uniform(0.05, 0.15), gross_share=rng.uniform(0.01, 0.03))
    return Layout(name="noisy", noise=Noise(point_mm=0.012, actuator_mm=0.002), faults=faults)


def _other(rng: np.random.Generator) -> Layout:
    geometry = telescope_geometry(
        base_radius=rng.uniform(180.0, 300.0),
        platform_radius=rng.uniform(120.0, 220.0),
        base_half_separation_deg=rng.uniform(8.0, 18.0),
        platform_half_separation_deg=rng.uniform(5.0, 12.0),
        length=rng.uniform(350.0, 700.0),
        rho0=rng.uniform(8.0, 30.0),
    )
    return Layout(name="other", geometry=geometry, targets=Targets(base=10, platform=8, per_leg=0), noise=Noise(0.008))


def _hexapod(rng: np.random.Generator) -> Layout:
    geometry = hexapod_geometry(base_radius=rng.uniform(180.0, 300.0), height=rng.uniform(280.0, 450.0))
    targets = Targets(base=12, platform=10, per_leg=0)
    return Layout(name="hexapod", geometry=geometry, targets=targets, noise=Noise(0.006, actuator_mm=0.002))


def _uneven(rng: np.random.Generator) -> Noise:
    """A camera above: heights are known two to four times worse than the rest."""
    return Noise(point_mm=0.004, axis_ratio=(1.0, 1.0, rng.uniform(2.0, 4.0)))


def _sigmas(rng: np.random.Generator) -> Layout:
    return Layout(name="sigmas", noise=replace(_uneven(rng), write_sigmas=True))


def _uneven_unrecorded(rng: np.random.Generator) -> Layout:
    # Photographed from the same side throughout, or the unevenness would be another one in every pose.
    return Layout(name="uneven", noise=_uneven(rng), surroundings=Surroundings(frame_turn_rad=0.2))


def _declared(factor: float) -> Callable[[np.random.Generator], Layout]:
    def layout(rng: np.random.Generator) -> Layout:
        noise = Noise(0.005, declared_point_mm=0.005 * factor, declared_actuator_mm=0.001 * factor)
        return Layout(name="declared", noise=noise)

    return layout


def _tails(rng: np.random.Generator) -> Layout:
    return Layout(name="tails", noise=Noise(heavy_tails=True), faults=DataFaults(gross_share=0.015))


def _few(rng: np.random.Generator) -> Layout:
    return Layout(name="few", targets=Targets(base=5, platform=5, per_leg=0))


def _many(rng: np.random.Generator) -> Layout:
    return Layout(name="many", targets=Targets(base=26, platform=22, per_leg=5), noise=Noise(0.01))


def _follow(rng: np.random.Generator) -> Layout:
    """A platform whose own targets go some of the way with the attachments."""
    return replace(_other(rng), name="follow", targets=Targets(base=9, platform=7, per_leg=0, follow=0.3))


def _bare(rng: np.random.Generator) -> Layout:
    return Layout(name="bare", targets=Targets(base=8, platform=8, on_attachments=(), per_leg=0))


LAYOUTS: dict[str, Callable[[np.random.Generator], Layout]] = {
    "telescope": _telescope,
    "noisy": _noisy,
    "other": _other,
    "hexapod": _hexapod,
    "sigmas": _sigmas,
    "uneven": _uneven_unrecorded,
    "declared low": _declared(1 - WRONG),
    "declared high": _declared(1 + WRONG),
    "tails": _tails,
    "few": _few,
    "many": _many,
    "follow": _follow,
    "bare": _bare,
}


def draw_plan(kind: str, needs: frozenset[str], seed: int) -> Plan:
    """A campaign's plan by the name of its layout. ``needs`` are names of further columns, and ``even`` where actuators
    must stand anywhere, ``wide`` where they must go far in little noise, ``upright`` where it must be stated which way
    is up, ``weighed`` where also what the legs carry.
    """
    rng = np.random.default_rng([seed, 1])
    layout = LAYOUTS[kind](rng)
    weight, mass_column = _weight(layout, needs, np.random.default_rng([seed, 4]))
    columns = (*sorted(needs & {"humidity_pct", "pressure_hpa", "load_n"}), *mass_column)
    surroundings = replace(
        layout.surroundings,
        temperature_step_c=float(rng.uniform(0.15, 0.5)),
        shuffled=bool(rng.random() < 0.4),
        columns=columns or (("humidity_pct",) if rng.random() < 0.3 else ()),
    )
    pitch = round(float(rng.uniform(0.3, 1.2)), 2) if "even" in needs and rng.random() < 0.5 else None
    layout = replace(layout, surroundings=surroundings, actuator_pitch_mm=pitch, weight=weight)
    if "wide" in needs:
        layout = replace(layout, noise=replace(layout.noise, point_mm=layout.noise.point_mm / 3))
    return Plan(kind, layout, _asked(layout, needs, rng), seed)


def _weight(layout: Layout, needs: frozenset[str], rng: np.random.Generator) -> tuple[Weight | None, tuple[str, ...]]:
    """Stated weight, and the column that states it pose by pose: where it is needed, and elsewhere now and
    then. A machine that hardly tilts shows a weight by its changes alone, one that tilts a little if it is heavy."""
    if not needs & {"weighed", "upright"} and rng.random() > WEIGHT_IS_STATED:
        return None, ()
    x, y = rng.uniform(-0.2, 0.2, 2)
    up = np.array([x, y, 1.0]) / np.linalg.norm([x, y, 1.0])
    x, y = rng.uniform(-20.0, 20.0, 2)
    tilts = layout.geometry.mechanism == "ups"
    by_pose = "weighed" in needs and (not tilts or rng.random() < 0.5)
    mass = None if by_pose else round(float(rng.uniform(100.0, 400.0)), 1)
    vector = tuple(float(value) for value in up.round(9))
    weight = Weight(vector, mass, (round(float(x), 1), round(float(y), 1), round(float(rng.uniform(0.0, 60.0)), 1)))
    return weight, ("payload_kg",) if by_pose else ()


def _asked(layout: Layout, needs: frozenset[str], rng: np.random.Generator) -> Sequence[Move] | Sequence[Place]:
    calibration = int(rng.choice([30, 36, 40, 40, 40, 40, 50, 70]))
    verification = int(rng.choice([0, 6, 6, 8, 10]))
    if layout.geometry.mechanism == "ups":
        return random_places(calibration, verification, rng)
    if "wide" in needs:
        return [at_rest(), *even_moves(calibration, verification, rng, WIDE_MM)]
    draw = rng.random()
    if "even" in needs or draw < 0.4:
        return [at_rest(), *even_moves(calibration, verification, rng, STROKE_MM)]
    if layout.name == "telescope" and draw < 0.8:
        return [at_rest(), *published_moves()]
    return [at_rest(), *random_moves(calibration, verification, rng)]
