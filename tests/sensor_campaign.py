"""A small force-sensor campaign: readings and signals of an elastic platform, loaded up and down axis by axis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truing.simulation.bench.six_upur import elements
from truing.simulation.bench.six_upur.geometry import joint_centres
from truing.simulation.bench.six_upur.stiffness import ElasticSensor, elastic_sensor

AXES = ("fx", "fy", "fz", "mx", "my", "mz")
CHANNELS = ("dx", "dy", "dz", "rx", "ry", "rz")
READING = np.array([1e6] * 3 + [180.0 * 3600.0 / np.pi] * 3)  # um and arcsec per m and rad
NOISE = np.array([0.5] * 3 + [0.2] * 3)
SIGNAL_MV, GAIN = 0.01, 0.02  # noise and mV per N
LARGEST = np.array([2000.0, 2000.0, 4000.0, 100.0, 100.0, 100.0])
UP_AND_DOWN = np.array([0, 1, 2, 3, 4, 3, 2, 1, 0, -1, -2, -3, -4, -3, -2, -1, 0]) / 4.0

_BASE, _TOP = np.radians([20, 100, 140, 220, 260, 340]), np.radians([40, 80, 160, 200, 280, 320])
HEIGHT_MM = 60.0


def _ring(radius_mm: float, angle: NDArray) -> NDArray:
    return radius_mm * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])


LOWER_MM, UPPER_MM = _ring(90.0, _BASE), _ring(50.0, _TOP)


def campaign_toml(name: str = "sensor", more: str = "") -> str:
    """campaign.toml of the bench; ``more``: further sections."""
    legs = "".join(
        f"  {{ B_mm = {B.round(6).tolist()}, b_mm = {b.round(6).tolist()} }},\n"
        for B, b in zip(LOWER_MM, UPPER_MM, strict=True)
    )
    return f"""[campaign]
name = "{name}"
kind = "interferometer"
[mechanism]
type = "6-upur"
height_mm = {HEIGHT_MM}
legs = [
{legs}]
elements = [
  {{ kind = "cylinder", length_mm = 30.0, diameter_mm = 5.0, youngs_gpa = 206.0, poisson = 0.3 }},
  {{ kind = "rigid" }},
]
[noise]
linear_um = {NOISE[0]}
angular_arcsec = {NOISE[3]}
signal_mv = {SIGNAL_MV}
{more}"""


def sensor() -> ElasticSensor:
    """The sensor of ``campaign_toml``."""
    joints = joint_centres(LOWER_MM * 1e-3, UPPER_MM * 1e-3, HEIGHT_MM * 1e-3)
    return elastic_sensor(joints, [elements.cylinder(0.03, 0.005, 206e9, 0.3), elements.rigid()])


def measured(
    rng: np.random.Generator, *, repeats: int = 1, own_channel: bool = False, stiffness: float = 1.0
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Readings and signals; each axis is loaded in ``repeats`` runs of all channels, or of its own one.

    Every reading has its noise, and every run and channel shares the noise of its zero; stiffness: over the simulated.
    """
    simulated = sensor()
    steps = len(UP_AND_DOWN)
    run = np.repeat(np.arange(6 * repeats) + 1, steps)
    axis = (run - 1) // repeats
    step = np.tile(np.arange(steps), 6 * repeats)
    load = np.tile(UP_AND_DOWN, 6 * repeats) * LARGEST[axis]
    wrench = np.zeros((len(run), 6))
    wrench[np.arange(len(run)), axis] = load
    zero = rng.normal(size=(6 * repeats, 6))[run - 1]
    reading = simulated.displacement(wrench) / stiffness * READING + NOISE * (rng.normal(size=(len(run), 6)) + zero)
    signal = GAIN * wrench @ simulated.axial_forces.T + SIGNAL_MV * rng.normal(size=(len(run), 6))
    common = {"run": run, "step": step, "load_axis": np.array(AXES)[axis], "load": load}
    time_s = 60.0 * np.arange(len(run))
    parts = [
        pd.DataFrame({**common, "time_s": time_s, "channel": channel, "reading": reading[:, k]}).loc[
            (axis == k) if own_channel else slice(None)
        ]
        for k, channel in enumerate(CHANNELS)
    ]
    signals = pd.DataFrame({**common, **{f"v{j + 1}_mv": signal[:, j] for j in range(6)}})
    return pd.concat(parts, ignore_index=True), signals


def write_campaign(folder: Path, readings: pd.DataFrame | None, signals: pd.DataFrame | None, toml: str) -> None:
    """Write campaign.toml and the tables that there are."""
    folder.mkdir(exist_ok=True)
    (folder / "campaign.toml").write_text(toml)
    for name, table in (("interferometer", readings), ("signals", signals)):
        if table is not None:
            table.to_csv(folder / f"{name}.csv", index=False)
