"""Settings of a campaign: nominal geometry, targets, noise, data faults, and schedule."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tests.blind.generator.quaternions import Array

LEGS = 6
BASE_CLOSE_PAIRS = ((2, 3), (4, 5), (6, 1))
PLATFORM_CLOSE_PAIRS = ((1, 2), (3, 4), (5, 6))


@dataclass(frozen=True)
class Geometry:
    """A 6-pus: a, b, u (6, 3) and leg length, rho0 (6,); base frame for a and u, platform frame for b; mm.

    Without any u, (0, 3), an ups of as many legs as there are a: the actuators are the legs.
    """

    a: Array
    b: Array
    u: Array
    length: Array
    rho0: Array
    flexure_length: float | None = 10.0

    @property
    def home_height(self) -> float:
        """Height of the level platform that the mean leg would reach; where the closure starts to look,
        mm.
        """
        sideways = np.mean(np.sum((self.b - self.a)[:, :2] ** 2, axis=1))
        if self.mechanism == "ups":
            return float(np.sqrt(np.mean(self.length + self.rho0) ** 2 - sideways))
        return float(np.sqrt(np.mean(self.length) ** 2 - sideways) + np.mean(self.rho0))

    @property
    def mechanism(self) -> str:
        """Its type in campaign.toml."""
        return "6-pus" if len(self.u) else "ups"


def telescope_geometry(
    *,
    base_radius: float = 154.0,
    platform_radius: float = 135.0,
    base_half_separation_deg: float = 9.2,
    platform_half_separation_deg: float = 6.0,
    length: float = 500.0,
    rho0: float = 10.0,
) -> Geometry:
    """Joints in close pairs on two circles, base pairs (2,3) (4,5) (6,1), platform pairs (1,2) (3,4) (5,6),
    actuators along z.
    """
    base = _pair_angles(BASE_CLOSE_PAIRS, (-30.0, 90.0, 210.0), base_half_separation_deg)
    platform = _pair_angles(PLATFORM_CLOSE_PAIRS, (-90.0, 30.0, 150.0), platform_half_separation_deg)
    return Geometry(
        a=_on_circle(base_radius, base),
        b=_on_circle(platform_radius, platform),
        u=np.tile([0.0, 0.0, 1.0], (LEGS, 1)),
        length=np.full(LEGS, length),
        rho0=np.full(LEGS, rho0),
    )


def _pair_angles(pairs: tuple[tuple[int, int], ...], middles_deg: tuple[float, ...], half_deg: float) -> Array:
    angles = np.empty(LEGS)
    for (first, second), middle in zip(pairs, middles_deg, strict=True):
        angles[first - 1], angles[second - 1] = np.deg2rad([middle - half_deg, middle + half_deg])
    return angles


def _on_circle(radius: float, angles: Array) -> Array:
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros_like(angles)], axis=1)


@dataclass(frozen=True)
class Tolerance:
    """One standard deviation of manufacturing and assembly: what the campaign declares, and what nature draws
    from.
    """

    a_mm: float = 0.5
    b_mm: float = 0.5
    u: float = 0.002
    length_mm: float = 0.5


@dataclass(frozen=True)
class Targets:
    """Number of targets on each body, and the share by which the platform's own targets follow the attachments."""

    base: int = 14
    platform: int = 12
    on_attachments: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    per_leg: int = 4
    follow: float = 0.0  # 0: targets away from the attachments stand still; 1: they move like their neighbourhood
    leg_frame: str = "joint"  # "joint": origin at the lower joint, z along the leg; "free": any frame


@dataclass(frozen=True)
class Noise:
    """True and declared noise of the instruments; one standard deviation each."""

    point_mm: float = 0.005
    axis_ratio: tuple[float, float, float] = (1.0, 1.0, 1.0)  # along the axes of the measurement frame
    declared_point_mm: float | None = None  # None: the truth, as root mean square over the axes
    write_sigmas: bool = False  # sigma_x_mm .. in points.csv
    survey_mm: float | None = None  # None: the same as a point
    actuator_mm: float = 0.001
    declared_actuator_mm: float | None = None
    heavy_tails: bool = False  # Student's t with 5 degrees of freedom, scaled to the same variance


@dataclass(frozen=True)
class DataFaults:
    """Faults that occur in any real data set."""

    missing_share: float = 0.02
    gross_share: float = 0.005
    gross_mm: tuple[float, float] = (0.1, 5.0)  # lengths of gross errors, log-uniform


@dataclass(frozen=True)
class Surroundings:
    """Measurement frame of each pose, time between poses, and random walk of the temperature."""

    frame_turn_rad: float = 3.0  # rotation vectors up to this length, direction at random
    frame_shift_mm: float = 1000.0
    pause_s: float = 240.0
    shuffled: bool = False  # True: poses were taken in another order than their ids
    reference_temperature_c: float = 20.0
    temperature_step_c: float = 0.05
    positioning_mm: float = 0.002  # how far an actuator stands from the value that was asked for
    columns: tuple[str, ...] = ()  # further columns of configurations.csv, names of schedule.COLUMNS


@dataclass(frozen=True)
class Weight:
    """Direction of gravity in the base frame; load of the legs, kg (None: the column payload_kg, or nothing is
    declared); centre of gravity in the platform frame, mm."""

    up: tuple[float, float, float]
    mass_kg: float | None = None
    centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Layout:
    """Everything about a campaign except the effects hidden in it and the seed."""

    name: str
    geometry: Geometry = field(default_factory=telescope_geometry)
    tolerance: Tolerance = Tolerance()
    targets: Targets = Targets()
    noise: Noise = Noise()
    faults: DataFaults = DataFaults()
    surroundings: Surroundings = Surroundings()
    decimals: int = 5
    actuator_pitch_mm: float | None = None
    weight: Weight | None = None
    certificate: tuple[str, ...] = ()  # lines of campaign.toml that follow [campaign]
    further_sections: tuple[str, ...] = ()  # lines of campaign.toml that the generator itself has no use for


def noiseless(layout_noise: Noise) -> Noise:
    """The same declaration, with instruments that make no error."""
    declared = layout_noise.declared_point_mm or layout_noise.point_mm
    return Noise(
        point_mm=0.0,
        declared_point_mm=declared,
        survey_mm=0.0,
        actuator_mm=0.0,
        declared_actuator_mm=layout_noise.declared_actuator_mm or layout_noise.actuator_mm,
    )
