"""The sample campaign with photographs: the sample telescope in its 47 poses, with a camera carried around it.

    python -m tests.photographs.telescope FOLDER [--poses 0 1 2] [--workers N]

The same machine, targets, configurations and hidden deformation as in the sample of points (without targets on legs).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from tests.blind.generator.campaign import Campaign, truth_record
from tests.blind.generator.certificate import certificate_lines
from tests.blind.generator.effects import MatrixDeformation
from tests.blind.generator.folder import truth_path, write_lines
from tests.blind.generator.layout import Layout, Targets
from tests.blind.generator.quaternions import Array, inverse, to_vector
from tests.blind.generator.schedule import at_rest, published_moves
from tests.blind.generator.telescope import LAYOUT as MACHINE
from tests.blind.generator.telescope import PUBLISHED_K
from tests.blind.generator.telescope import SEED as MACHINE_SEED
from tests.photographs.drawing import radiance
from tests.photographs.lens import Lens, View, direction
from tests.photographs.ray_folder import bar_rows, lens_record, write_machine_tables
from tests.photographs.rays import BARS, exact_campaign, normals
from tests.photographs.sensor import Grey, Sensor, save
from tests.photographs.stations import Round, stand_round
from tests.photographs.telescope_scene import DOT_MM, FAMILY, PosedTelescope, code_of, telescope_scene

SEED = 46
SAMPLE_POSES = (0, 1, 2)
LAYOUT: Layout = replace(
    MACHINE,
    name="telescope-images",
    targets=Targets(per_leg=0),
    certificate=certificate_lines("hexapod of a telescope, simulated", "camera, simulated", "2026-11-22", "2026-11-22"),
)
LENS, SENSOR, STATIONS = Lens(name="camera"), Sensor(), Round()
PHOTOGRAPHS = (
    "",
    "[photographs]",
    f'targets = ["{FAMILY}"]',
    "uncoded = true",
    f"target_mm = {2 * DOT_MM}",
)


@dataclass(frozen=True)
class Session:
    """All poses as they were photographed: lens, sensor, and a row of stations (N, S) per pose."""

    lens: Lens = LENS
    sensor: Sensor = SENSOR
    stations: Round = STATIONS
    quality: int = 93

    @cached_property
    def campaign(self) -> Campaign:
        """The machine's campaign, points as they truly are in the base frame."""
        moves = [at_rest(), *published_moves()]
        effects = [MatrixDeformation(PUBLISHED_K)]
        return exact_campaign(LAYOUT, moves, effects, np.random.default_rng(MACHINE_SEED))

    @cached_property
    def names(self) -> tuple[tuple[str, str], ...]:
        """Body and target of every point, bars' ends at the end."""
        marks = self.campaign.marks
        return (*zip(marks.body, marks.name, strict=True), *(name for bar in BARS for name in bar.targets))

    @cached_property
    def points(self) -> Array:
        """All points (N, M, 3) in the base frame, mm."""
        ends = np.array([bar.ends_mm for bar in BARS]).reshape(-1, 3)
        own = self.campaign.record.points
        return np.concatenate([own, np.broadcast_to(ends, (len(own), *ends.shape))], axis=1)

    @cached_property
    def normals(self) -> Array:
        """Normals (N, M, 3)."""
        return normals(self.campaign, len(BARS))

    @cached_property
    def calibrated_mm(self) -> Array:
        """The bars' lengths as a laboratory stated them."""
        rng = np.random.default_rng([SEED, 1])
        return np.array([bar.length_mm + bar.sigma_mm * rng.normal() for bar in BARS])

    def view(self, n: int) -> View:
        """The stations of pose number n."""
        return stand_round(self.stations, np.random.default_rng([SEED, 2, n]))

    def photograph(self, n: int, station: int) -> Grey:
        """One photograph, the same one every time."""
        round_ = self.view(n)
        view = View(round_.turn[station], round_.centre[station])
        posed = PosedTelescope(self.campaign, self.names, self.points[n], self.normals[n], n)
        light = radiance(self.lens, view, telescope_scene(posed), self.sensor.blur_px)
        return self.sensor.expose(light, self.lens, np.random.default_rng([SEED, 3, n, station]))

    def true_pixels(self, n: int) -> Array:
        """Exact images of the circles' centres in every photograph of a pose (S, M, 2), px."""
        round_ = self.view(n)
        view = View(round_.turn[:, None], round_.centre[:, None])
        pixel = self.lens.image_of(direction(view.seen(self.points[n])))
        return np.stack([pixel.real, pixel.imag], axis=-1)


def write_campaign(folder: Path, poses: tuple[int, ...] | None = None, workers: int = 1) -> Path:
    """Fills ``folder`` (made where missing) with poses by id (None: all) and writes the truth next to it."""
    session = Session()
    write_tables(session, folder, poses)
    chosen = _numbers(session, poses)
    truth = json.dumps(_truth(session, chosen), separators=(",", ":"))
    write_lines(truth_path(folder), [truth])
    tasks = [(session, n, s, folder) for n in chosen for s in range(session.stations.count)]
    for n in chosen:
        (folder / "images" / str(session.campaign.schedule.pose[n])).mkdir(parents=True, exist_ok=True)
    if workers == 1:
        for task in tasks:
            _save(task)
    else:
        with get_context("spawn").Pool(workers) as pool:
            pool.map(_save, tasks, chunksize=len(tasks) // workers + 1)
    return folder


def write_tables(session: Session, folder: Path, poses: tuple[int, ...] | None) -> Path:
    """Writes everything but the photographs."""
    folder.mkdir(parents=True, exist_ok=True)
    write_machine_tables(session.campaign, folder, PHOTOGRAPHS)
    if poses is not None:
        _keep(folder / "configurations.csv", {str(pose) for pose in poses})
    write_lines(folder / "scale_bars.csv", bar_rows(BARS, session.calibrated_mm))
    write_lines(folder / "image_targets.csv", _image_targets(session))
    return folder


def _numbers(session: Session, poses: tuple[int, ...] | None) -> list[int]:
    return [n for n, pose in enumerate(session.campaign.schedule.pose) if poses is None or pose in poses]


def _save(task: tuple[Session, int, int, Path]) -> None:
    session, n, station, folder = task
    pose = session.campaign.schedule.pose[n]
    path = folder / "images" / str(pose) / f"{pose:02d}-{station + 1:02d}.jpg"
    save(session.photograph(n, station), path, session.lens, session.quality)


def _keep(path: Path, poses: set[str]) -> None:
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    write_lines(path, [head, *(row for row in rows if row.split(",")[0] in poses)])


def _image_targets(session: Session) -> Iterator[str]:
    yield "family,code,body,target,diameter_mm"
    for body, target in session.names:
        code = code_of(body, target)
        if code:
            yield f"{FAMILY},{code},{body},{target},{2 * DOT_MM}"


def _truth(session: Session, chosen: list[int]) -> dict[str, object]:
    campaign = session.campaign
    reported = truth_record(campaign, SEED)
    poses = reported["poses"]
    assert isinstance(poses, list)
    photographs = []
    for n in chosen:
        round_, pixels = session.view(n), session.true_pixels(n)
        for s in range(session.stations.count):
            photographs.append(
                {
                    "pose": campaign.schedule.pose[n],
                    "station": s + 1,
                    "centre_mm": round_.centre[s].round(6).tolist(),
                    "rotation_vector_rad": to_vector(inverse(round_.turn[s])).round(9).tolist(),
                    "pixels": pixels[s].round(4).tolist(),
                }
            )
    return reported | {
        "poses": [poses[n] for n in chosen],
        "camera": lens_record(session.lens),
        "bars": [{"bar": bar.name, "true_mm": bar.length_mm} for bar in BARS],
        "points": ["/".join(name) for name in session.names],
        "points_mm": {str(campaign.schedule.pose[n]): session.points[n].round(6).tolist() for n in chosen},
        "photographs": photographs,
    }


def main() -> None:
    """Writes the campaign with its photographs into a folder, and the truth next to it."""
    parser = argparse.ArgumentParser(prog="python -m tests.photographs.telescope", description=main.__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--poses", type=int, nargs="+", help="these poses alone, by id (else all 47)")
    parser.add_argument("--workers", type=int, default=1, help="processes side by side")
    asked = parser.parse_args()
    write_campaign(asked.folder, asked.poses and tuple(asked.poses), asked.workers)


if __name__ == "__main__":
    main()
