"""Image points of a photographed campaign without rendering: measured coordinates of every target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.campaign import Campaign, Move, draw_campaign
from tests.blind.generator.effects import Effect
from tests.blind.generator.layout import DataFaults, Layout, Surroundings, Targets
from tests.blind.generator.quaternions import Array, from_vector, inverse, rotate, unit
from tests.photographs.hidden import CameraEffect
from tests.photographs.lens import Lens, View, direction
from tests.photographs.stations import Round, stand_round

Flags = NDArray[np.bool_]
Names = tuple[tuple[str, str], ...]  # body and target


@dataclass(frozen=True)
class Bar:
    """A scale bar: where its two ends are in the scene (mm), how well its length is known, and how far a length as
    seen in one pose lies about it (mm).
    """

    name: str
    ends_mm: tuple[tuple[float, float, float], tuple[float, float, float]]
    sigma_mm: float = 0.005
    repeat_mm: float = 0.0

    @property
    def length_mm(self) -> float:
        """Its true length at the reference temperature, mm."""
        return float(np.linalg.norm(np.subtract(*self.ends_mm)))

    @property
    def targets(self) -> Names:
        """The names of its ends."""
        return ("bars", f"{self.name}1"), ("bars", f"{self.name}2")


BARS = (
    Bar("S", ((-300.0, -290.0, 15.0), (300.0, -295.0, 25.0))),
    Bar("T", ((-285.0, 255.0, 12.0), (215.0, 300.0, 22.0))),
)


@dataclass(frozen=True)
class Shooting:
    """A photographed campaign: layout of the machine, lenses (assigned to stations in turn), stations of each pose,
    true and declared uncertainty of image coordinates, scale bars, and faults."""

    layout: Layout = field(
        default_factory=lambda: Layout(
            name="photographed",
            targets=Targets(per_leg=0),
            surroundings=Surroundings(temperature_step_c=0.3),
        )
    )
    lenses: tuple[Lens, ...] = (Lens(),)
    stations: Round = field(default_factory=Round)
    sigma_px: float = 0.02
    stated_sigma_px: float | None = None
    bars: tuple[Bar, ...] = BARS
    widest_deg: float = 68.0  # between a target's normal and the line of sight
    missing_share: float = 0.03
    gross_share: float = 0.002
    gross_px: tuple[float, float] = (0.3, 30.0)  # log-uniform
    coded_share: float = 0.6


@dataclass(frozen=True)
class Photographed:
    """A campaign, its views (a row of stations per pose), and its rays: pose, station and point by number, pixels
    (R,), which are grossly wrong, and the true length of each bar as it was stated (mm).
    """

    shooting: Shooting
    campaign: Campaign
    effects: tuple[CameraEffect, ...]
    views: View  # turn (N, S, 4), centre (N, S, 3), base frame
    names: Names
    points: Array  # (N, M, 3) true, base frame, bars' ends at the end
    coded: Flags
    pose: NDArray[np.int64]
    station: NDArray[np.int64]
    point: NDArray[np.int64]
    pixel: NDArray[np.complex128]
    gross: Flags
    calibrated_mm: Array

    def camera_of(self, station: int) -> Lens:
        """The lens at a station."""
        return self.shooting.lenses[station % len(self.shooting.lenses)]


def exact_campaign(
    layout: Layout, moves: Sequence[Move], effects: Sequence[Effect], seed: np.random.Generator
) -> Campaign:
    """The machine's campaign with its points as they truly are in the base frame; the survey and the actuators'
    readings keep the noise of the layout.
    """
    noise = layout.noise
    still = replace(
        layout,
        noise=replace(
            noise,
            point_mm=0.0,
            declared_point_mm=noise.declared_point_mm or noise.point_mm,
            survey_mm=noise.point_mm if noise.survey_mm is None else noise.survey_mm,
        ),
        faults=DataFaults(missing_share=0.0, gross_share=0.0),
        surroundings=replace(layout.surroundings, frame_turn_rad=0.0, frame_shift_mm=0.0),
    )
    return draw_campaign(still, moves, effects, seed)


def draw_rays(
    shooting: Shooting,
    moves: Sequence[Move],
    machine_effects: Sequence[Effect],
    camera_effects: Sequence[CameraEffect],
    rng: np.random.Generator,
) -> Photographed:
    """Photographs a campaign; machine, stations, bars, noise and faults each draw from a stream of their own, so that
    an effect changes nothing else.
    """
    machine, stations, bars, noise, faults = rng.spawn(5)
    campaign = exact_campaign(shooting.layout, moves, machine_effects, machine)
    poses = len(campaign.schedule.pose)
    rounds = [stand_round(shooting.stations, stations) for _ in range(poses)]
    views = View(np.stack([r.turn for r in rounds]), np.stack([r.centre for r in rounds]))
    ends, calibrated = _bar_ends(shooting.bars, campaign, camera_effects, bars)
    points = np.concatenate([campaign.record.points, ends], axis=1)
    exact = _pixels(shooting, campaign, camera_effects, views, points)
    seen = _seen(shooting, campaign, views, points, exact, faults)
    pose, station, point = np.nonzero(seen)
    scatter = shooting.sigma_px * (noise.normal(size=seen.shape) + 1j * noise.normal(size=seen.shape))
    wrong = _wrong(shooting, seen, faults)
    marks = campaign.marks
    names = (*zip(marks.body, marks.name, strict=True), *(name for bar in shooting.bars for name in bar.targets))
    return Photographed(
        shooting,
        campaign,
        tuple(camera_effects),
        views,
        names,
        points,
        _coded(len(names), shooting.coded_share),
        pose,
        station,
        point,
        (exact + scatter + wrong)[seen],
        (wrong != 0)[seen],
        calibrated,
    )


def _bar_ends(
    bars: tuple[Bar, ...], campaign: Campaign, effects: Sequence[CameraEffect], rng: np.random.Generator
) -> tuple[Array, Array]:
    """Ends (N, 2 K, 3) of the bars in every pose, mm, and lengths (K,) as a laboratory stated them."""
    poses = len(campaign.schedule.pose)
    if not bars:
        return np.empty((poses, 0, 3)), np.empty(0)
    ends = np.array([bar.ends_mm for bar in bars])
    middle, half = ends.mean(axis=1), (ends[:, 1] - ends[:, 0]) / 2
    factor = np.ones((poses, len(bars)))
    for effect in effects:
        factor = factor * effect.growth(tuple(bar.name for bar in bars), campaign.schedule)
    length = np.array([bar.length_mm for bar in bars])
    factor = factor + rng.normal(size=factor.shape) * np.array([bar.repeat_mm for bar in bars]) / length
    reported = length + rng.normal(size=len(bars)) * np.array([bar.sigma_mm for bar in bars])
    sides = np.array([-1.0, 1.0])
    placed = middle[:, None] + (factor[..., None, None] * sides[:, None]) * half[:, None]
    return placed.reshape(poses, -1, 3), reported


def _pixels(
    shooting: Shooting, campaign: Campaign, effects: Sequence[CameraEffect], views: View, points: Array
) -> NDArray[np.complex128]:
    """Exact image of every point in every camera (N, S, M)."""
    view = View(views.turn[:, :, None], views.centre[:, :, None])
    seen = view.seen(points[:, None])
    for effect in effects:
        seen = effect.bend(seen, view)
    w = direction(seen)
    pixel = np.empty(w.shape, complex)
    for n in range(len(pixel)):
        for k, lens in enumerate(shooting.lenses):
            for effect in effects:
                lens = effect.lens(lens, n, campaign.schedule)
            pixel[n, k :: len(shooting.lenses)] = lens.image_of(w[n, k :: len(shooting.lenses)])
    return pixel


def normals(campaign: Campaign, bars: int) -> Array:
    """Normals of all targets (N, M, 3), base frame: up, leaning outwards by different amounts; those of bars point
    up."""
    place, marks = campaign.marks.place, campaign.marks
    lean = np.deg2rad(3.0 + 4.0 * (np.arange(len(place)) % 3))[:, None]
    outwards = unit(place * [1.0, 1.0, 0.0] + [1e-9, 0.0, 0.0])
    own = np.cos(lean) * np.array([0.0, 0.0, 1.0]) + np.sin(lean) * outwards
    facing = np.repeat(own[None], len(campaign.schedule.pose), axis=0)
    platform = np.array([body == "platform" for body in marks.body])
    turn = from_vector(campaign.truth.rotation_vector)
    facing[:, platform] = rotate(turn[:, None], facing[:, platform])
    up = np.broadcast_to([0.0, 0.0, 1.0], (len(facing), 2 * bars, 3))
    return np.concatenate([facing, up], axis=1)


def _seen(
    shooting: Shooting,
    campaign: Campaign,
    views: View,
    points: Array,
    pixel: NDArray[np.complex128],
    rng: np.random.Generator,
) -> Flags:
    """Mask (N, S, M) of the targets that are in the format, face the camera and were not lost."""
    sight = unit(views.centre[:, :, None] - points[:, None])
    facing = np.sum(sight * normals(campaign, len(shooting.bars))[:, None], axis=-1)
    inside = np.empty(pixel.shape, bool)
    for k, lens in enumerate(shooting.lenses):
        own = np.s_[:, k :: len(shooting.lenses)]
        inside[own] = lens.inside(pixel[own], margin_px=25.0)
    ahead = View(views.turn[:, :, None], views.centre[:, :, None]).seen(points[:, None])[..., 2] > 0
    kept = rng.uniform(size=pixel.shape) >= shooting.missing_share
    return inside & ahead & kept & (facing > np.cos(np.deg2rad(shooting.widest_deg)))


def _wrong(shooting: Shooting, seen: Flags, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Gross errors (N, S, M), zero for most, px."""
    low, high = np.log(shooting.gross_px)
    size = np.exp(rng.uniform(low, high, seen.shape)) * np.exp(2j * np.pi * rng.uniform(size=seen.shape))
    return np.where(rng.uniform(size=seen.shape) < shooting.gross_share, size, 0.0)


def _coded(count: int, share: float) -> Flags:
    """Mask of the targets that carry a code: a share, spread evenly over the list."""
    return np.floor(np.arange(1, count + 1) * share) > np.floor(np.arange(count) * share)


def true_turns(photographed: Photographed) -> Array:
    """Turns (N, S, 4) from the cameras' axes into the base frame."""
    return inverse(photographed.views.turn)
