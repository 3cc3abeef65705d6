"""Settings of a force-sensor campaign: sensor, loads, measured channels, noise, and surroundings."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor.designs import nominal_a
from tests.blind.generator.sensor.machine import Sensor

AXES = ("fx", "fy", "fz", "mx", "my", "mz")
CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
LOADS = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
ARCSEC = np.pi / 180 / 3600
FILE_UNIT = np.array([1e-6] * 3 + [ARCSEC] * 3)
"""What one um or arc second of each channel is in m or rad."""
UNITS = ("um",) * 3 + ("arcsec",) * 3
# Table 3 of the force-sensor paper in thousandths of 10 kN or 10 kN m: up and down, then the other way.
UP_AND_DOWN = (100, 300, 500, 700, 900, 700, 500, 300, 100, 0)


@dataclass(frozen=True)
class Tolerance:
    """Full widths T, m, of which nature draws with sigma = T / 6; the elastic parameters' own sigma, relative."""

    platform_radius: float = 155e-6
    base_radius: float = 130e-6
    lower_clearance: float = 36e-6
    middle_clearance: float = 36e-6
    sensor_installation: float = 87e-6
    stiffness: float = 0.0
    common: float = 0.5  # share of the elastic parameters' variance that all legs have in common


@dataclass(frozen=True)
class Noise:
    """True noise of the instruments, one sigma; loads are exact unless declared otherwise."""

    linear: float = 0.5e-6
    angular: float = 0.2 * ARCSEC
    signal_mv: float = 0.01
    force: float = 0.0
    torque: float = 0.0
    exact: bool = False  # the same declaration, of instruments that make no error

    @property
    def channels(self) -> Array:
        """Of each channel (6,), m and rad."""
        return np.array([self.linear] * 3 + [self.angular] * 3)


@dataclass(frozen=True)
class DataFaults:
    """Possible faults: lost readings, lost load steps, channels never measured, gross errors."""

    missing_share: float = 0.0
    missing_steps: float = 0.0
    never: tuple[str, ...] = ()
    gross_share: float = 0.0
    gross_sigma: tuple[float, float] = (10.0, 300.0)


@dataclass(frozen=True)
class Programme:
    """The runs: one axis at a time or several, with which channels, how often, and how the load goes.

    ``channels``: "own" (each axis with its own channel), "separate" (every channel in a run of its own) or "all".
    ``levels``: shares of the range in thousandths, in the order in which they are applied.
    """

    axes: tuple[str, ...] = AXES
    channels: str = "all"
    repeats: int = 1
    held_out: int = 0  # of the repeats, that many have the role verification; 0: no roles
    levels: tuple[int, ...] = (0, *UP_AND_DOWN, *(-level for level in UP_AND_DOWN))
    together: int = 0  # runs of loads along several axes at once, in place of the others
    steps_together: int = 24
    pause_s: float = 90.0
    uneven: float = 0.2  # pauses differ by up to this share
    lunch_s: float = 0.0  # a break within some runs


@dataclass(frozen=True)
class Surroundings:
    """The hall: how far it swings over a day, and how it walks in an hour."""

    recorded: bool = True
    day_k: float = 0.4
    air_k: float = 0.08
    pressure_hpa: float = 0.5
    humidity_pct: float = 1.5
    lag_s: float = 7200.0  # of the material behind the air
    reference_temperature_c: float = 20.0


@dataclass(frozen=True)
class Interferometer:
    """Its vacuum wavelength, m, the dead path that is known of, and whether readings come compensated for the air."""

    wavelength: float = 632.990577e-9
    dead_path: float = 0.0
    compensated: bool = True


@dataclass(frozen=True)
class Layout:
    """Everything about a campaign but the effects hidden in it and the seed."""

    name: str
    sensor: Sensor = field(default_factory=nominal_a)
    range: tuple[float, ...] = (10e3, 10e3, 10e3, 5e3, 5e3, 5e3)
    tolerance: Tolerance = Tolerance()
    noise: Noise = Noise()
    faults: DataFaults = DataFaults()
    programme: Programme = Programme()
    surroundings: Surroundings = Surroundings()
    interferometer: Interferometer = Interferometer()
    signals: int = 0
    written_as: str = "interferometer"  # or "displacement"
    compliance_given: bool = False
    stated_range: bool = True
    certificate: tuple[str, ...] = ()  # lines of campaign.toml that follow [campaign]


def noiseless(layout: Layout) -> Layout:
    """The same campaign measured by instruments that make no error, losses as they are."""
    faults = replace(layout.faults, gross_share=0.0)
    return replace(layout, noise=replace(layout.noise, exact=True), faults=faults)
