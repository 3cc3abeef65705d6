"""The campaign folder of a hexapod whose base and platform were measured by photogrammetry; m, written in mm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

Array = np.ndarray


@dataclass(frozen=True)
class Noise:
    """One standard deviation of a point's coordinate and of a reading, m."""

    point: float = 1.5e-6
    actuator: float = 0.2e-6


@dataclass(frozen=True)
class Seen:
    """Measurement in N poses: true p (N, 3) and R (N, 3, 3), true readings (N, L), and roles."""

    p: Array
    R: Array
    readings: Array
    roles: list[str]


def ring(radius: float, count: int, height: float, rng: np.random.Generator) -> Array:
    """Targets about a circle, at uneven heights (count, 3)."""
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    size = radius * (1 + 0.2 * (-1.0) ** np.arange(count))
    return np.stack([size * np.cos(angle), size * np.sin(angle), height * rng.uniform(0, 1, count)], 1)


def write(
    folder: Path,
    seen: Seen,
    mechanism: str,
    sections: str,
    rng: np.random.Generator,
    *,
    noise: Noise = Noise(),
    columns: Mapping[str, Array] | None = None,
    radii: tuple[float, float] = (0.26, 0.14),
) -> Path:
    """Write campaign.toml, points.csv, targets.csv and configurations.csv; return the folder.

    ``mechanism``: lines of [mechanism]; ``sections``: further sections; ``columns``: of configurations.csv, by pose.
    """
    folder.mkdir(parents=True)
    bodies = {"base": ring(radii[0], 12, 0.04, rng), "platform": ring(radii[1], 12, 0.04, rng)}
    name = f'[campaign]\nname = "{folder.name}"\nkind = "photogrammetry"\n\n[mechanism]\n{mechanism}\n{sections}\n'
    known = f"\n[noise]\npoint_mm = {1e3 * noise.point:.7g}\nactuator_mm = {1e3 * noise.actuator:.7g}\n"
    (folder / "campaign.toml").write_text(name + known, encoding="utf-8")
    rows = ["body,target,x_mm,y_mm,z_mm,leg"]
    for body, places in bodies.items():
        survey = 1e3 * (places + rng.normal(0, noise.point, places.shape))
        rows += [f"{body},{body[0].upper()}{k:02d},{_row(one)}," for k, one in enumerate(survey)]
    (folder / "targets.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (folder / "points.csv").write_text("\n".join(_points(seen, bodies, noise, rng)) + "\n", encoding="utf-8")
    (folder / "configurations.csv").write_text("\n".join(_poses(seen, noise, columns or {}, rng)) + "\n", "utf-8")
    return folder


def _points(seen: Seen, bodies: Mapping[str, Array], noise: Noise, rng: np.random.Generator):
    yield "pose,body,target,x_mm,y_mm,z_mm"
    for n, (p, R) in enumerate(zip(seen.p, seen.R, strict=True)):
        camera, away = Rotation.random(random_state=rng).as_matrix(), rng.normal(0, 0.5, 3)
        for body, places in bodies.items():
            at = places if body == "base" else places @ R.T + p
            given = 1e3 * (at @ camera.T + away + rng.normal(0, noise.point, at.shape))
            yield from (f"{n},{body},{body[0].upper()}{k:02d},{_row(one)}" for k, one in enumerate(given))


def _poses(seen: Seen, noise: Noise, columns: Mapping[str, Array], rng: np.random.Generator):
    count = seen.readings.shape[1]
    yield ",".join(["pose", "role", "time_s", *(f"rho{i + 1}_mm" for i in range(count)), "temperature_c", *columns])
    for n, reading in enumerate(seen.readings):
        given = _row(1e3 * (reading + rng.normal(0, noise.actuator, count)))
        further = "".join(f",{float(values[n]):.10g}" for values in columns.values())
        yield f"{n},{seen.roles[n]},{100 * n + rng.uniform(-20, 20):.1f},{given},20.0{further}"


def _row(values: Array) -> str:
    return ",".join(f"{value:.7f}" for value in values)


def vector(values: Array) -> str:
    """A list of toml, m as mm."""
    return "[" + ", ".join(f"{1e3 * value + 0.0:.9f}" for value in values) + "]"
