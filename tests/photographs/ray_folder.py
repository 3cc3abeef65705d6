"""Write a campaign of rays as a campaign folder, and the truth next to it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.blind.generator.campaign import Campaign, truth_record
from tests.blind.generator.folder import campaign_toml, configurations, targets, truth_path, write_lines
from tests.blind.generator.named_effect import as_record
from tests.blind.generator.quaternions import to_vector
from tests.photographs.lens import Lens
from tests.photographs.rays import Bar, Photographed, true_turns


def write_rays(photographed: Photographed, folder: Path, seed: int) -> Path:
    """Fills ``folder`` (made where missing) and writes ``<folder>.truth.json`` next to it; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    shooting = photographed.shooting
    write_machine_tables(photographed.campaign, folder, ())
    write_lines(folder / "image_points.csv", _image_points(photographed))
    write_lines(folder / "cameras.csv", camera_rows(shooting.lenses))
    if shooting.bars:
        write_lines(folder / "scale_bars.csv", bar_rows(shooting.bars, photographed.calibrated_mm))
    truth = json.dumps(_truth(photographed, seed), indent=1)
    write_lines(truth_path(folder), [truth])
    return folder


def write_machine_tables(campaign: Campaign, folder: Path, further: tuple[str, ...]) -> None:
    """Write the files that do not come from photographs: campaign.toml (with further lines), targets.csv,
    configurations.csv."""
    write_lines(folder / "campaign.toml", [*campaign_toml(campaign), *further])
    write_lines(folder / "targets.csv", targets(campaign))
    write_lines(folder / "configurations.csv", configurations(campaign))


def camera_rows(lenses: tuple[Lens, ...]) -> Iterator[str]:
    """Start values as a data sheet gives them: format, pitch, and a focal length rounded to a millimetre."""
    yield "camera,width_px,height_px,pixel_um,c_mm"
    for lens in lenses:
        c_mm = round(lens.focal_px * lens.pitch_um / 1000)
        yield f"{lens.name},{lens.width_px},{lens.height_px},{lens.pitch_um},{c_mm}"


def bar_rows(bars: tuple[Bar, ...], calibrated_mm: np.ndarray) -> Iterator[str]:
    """Bars as a laboratory calibrated them."""
    repeat = any(bar.repeat_mm for bar in bars)
    yield "bar,first,second,length_mm,sigma_mm" + (",repeat_sigma_mm" if repeat else "")
    for bar, length in zip(bars, calibrated_mm, strict=True):
        first, second = ("/".join(name) for name in bar.targets)
        own = f",{bar.repeat_mm}" if repeat else ""
        yield f"{bar.name},{first},{second},{length:.4f},{bar.sigma_mm}{own}"


def _image_points(photographed: Photographed) -> Iterator[str]:
    shooting, campaign = photographed.shooting, photographed.campaign
    sigma = shooting.sigma_px if shooting.stated_sigma_px is None else shooting.stated_sigma_px
    yield "pose,image,camera,body,target,kind,x_px,y_px,sigma_x_px,sigma_y_px"
    rows = zip(photographed.pose, photographed.station, photographed.point, photographed.pixel, strict=True)
    for n, s, k, pixel in rows:
        pose = campaign.schedule.pose[n]
        body, target = photographed.names[k]
        kind = "ring12" if photographed.coded[k] else "circle"
        place = f"{pixel.real:.4f},{pixel.imag:.4f},{sigma},{sigma}"
        yield f"{pose},{image_name(pose, s)},{photographed.camera_of(s).name},{body},{target},{kind},{place}"


def image_name(pose: int, station: int) -> str:
    """The name of a photograph."""
    return f"{pose:02d}-{station + 1:02d}"


def _truth(photographed: Photographed, seed: int) -> dict[str, object]:
    campaign = photographed.campaign
    reported = truth_record(campaign, seed)
    effects = reported["effects"]
    assert isinstance(effects, list)
    effects += [as_record(effect) for effect in photographed.effects]
    wrong = np.flatnonzero(photographed.gross)
    return reported | {
        "gross_errors": [
            [
                image_name(campaign.schedule.pose[photographed.pose[r]], photographed.station[r]),
                *photographed.names[photographed.point[r]],
            ]
            for r in wrong
        ],
        "lenses": [lens_record(lens) for lens in photographed.shooting.lenses],
        "bars": [{"bar": bar.name, "true_mm": bar.length_mm} for bar in photographed.shooting.bars],
        "noise": {"image_px": photographed.shooting.sigma_px},
        "stations": [
            {
                "pose": pose,
                "centre_mm": photographed.views.centre[n].round(6).tolist(),
                "rotation_vector_rad": to_vector(true_turns(photographed)[n]).round(9).tolist(),
            }
            for n, pose in enumerate(campaign.schedule.pose)
        ],
    }


def lens_record(lens: Lens) -> dict[str, object]:
    """A lens as plain values."""
    return {
        "camera": lens.name,
        "width_px": lens.width_px,
        "height_px": lens.height_px,
        "focal_px": lens.focal_px,
        "principal_px": [lens.principal_px.real, lens.principal_px.imag],
        "radial": list(lens.radial),
        "decentring": [lens.decentring.real, lens.decentring.imag],
        "stretch": lens.stretch,
        "shear": lens.shear,
    }
