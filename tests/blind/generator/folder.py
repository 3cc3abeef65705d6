"""Writes a campaign as the folder that the campaign format describes, and the truth next to the folder."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tests.blind.generator.campaign import Campaign, truth_record
from tests.blind.generator.instrument import declared_sigma
from tests.blind.generator.quaternions import Array


def write_campaign(campaign: Campaign, folder: Path, seed: int) -> Path:
    """Fills ``folder`` (made where missing) and writes ``<folder>.truth.json`` next to it; returns the
    folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_lines(folder / "campaign.toml", campaign_toml(campaign))
    write_lines(folder / "points.csv", _points(campaign))
    write_lines(folder / "targets.csv", targets(campaign))
    write_lines(folder / "configurations.csv", configurations(campaign))
    truth = json.dumps(truth_record(campaign, seed), indent=1)
    write_lines(truth_path(folder), [truth])
    return folder


def truth_path(folder: Path) -> Path:
    """Path of the file with the truth of a campaign folder."""
    return folder.with_name(f"{folder.name}.truth.json")


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Writes a text file, alike on every system."""
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _points(campaign: Campaign) -> Iterable[str]:
    noise, decimals = campaign.layout.noise, campaign.layout.decimals
    sigmas = "," + _numbers(declared_sigma(noise)[1], 6) if noise.write_sigmas else ""
    yield "pose,body,target,x_mm,y_mm,z_mm" + (",sigma_x_mm,sigma_y_mm,sigma_z_mm" if sigmas else "")
    marks = list(zip(campaign.marks.body, campaign.marks.name, strict=True))
    for n, pose in enumerate(campaign.schedule.pose):
        for k in np.flatnonzero(campaign.record.is_observed[n]):
            body, name = marks[k]
            yield f"{pose},{body},{name},{_numbers(campaign.record.points[n, k], decimals)}{sigmas}"


def targets(campaign: Campaign) -> Iterable[str]:
    """The lines of targets.csv."""
    marks = campaign.marks
    yield "body,target,x_mm,y_mm,z_mm,leg"
    for body, name, leg, place in zip(marks.body, marks.name, marks.on_leg, campaign.surveyed, strict=True):
        yield f"{body},{name},{_numbers(place, campaign.layout.decimals)},{leg or ''}"


def configurations(campaign: Campaign) -> Iterable[str]:
    """The lines of configurations.csv."""
    schedule = campaign.schedule
    legs = campaign.readings.shape[1]
    heads = [f"rho{i}_mm" for i in range(1, legs + 1)]
    yield ",".join(["pose", "role", "time_s", *heads, "temperature_c", *schedule.further])
    for n, pose in enumerate(schedule.pose):
        readings = _numbers(campaign.readings[n], campaign.layout.decimals)
        air = "".join(f",{column[n]:.2f}" for column in (schedule.temperature_c, *schedule.further.values()))
        yield f"{pose},{schedule.role[n]},{schedule.time_s[n]:.1f},{readings}{air}"


def _numbers(values: Array, decimals: int) -> str:
    return ",".join(f"{value:.{decimals}f}" for value in values)


def campaign_toml(campaign: Campaign) -> Iterable[str]:
    """The lines of campaign.toml."""
    layout = campaign.layout
    yield "format = 1"
    yield from ("", "[campaign]", f'name = "{layout.name}"', 'kind = "photogrammetry"', *layout.certificate)
    yield from ("", "[mechanism]", f'type = "{layout.geometry.mechanism}"')
    yield f"reference_temperature_c = {layout.surroundings.reference_temperature_c}"
    if layout.actuator_pitch_mm is not None:
        yield f"actuator_pitch_mm = {layout.actuator_pitch_mm}"
    if layout.weight is not None and layout.weight.mass_kg is not None:
        yield f"payload_kg = {layout.weight.mass_kg}"
    if layout.weight is not None:
        yield f"payload_com_mm = {_vector(np.array(layout.weight.centre_mm))}"
    yield "legs = ["
    yield from (f"  {_leg(campaign, i)}," for i in range(len(layout.geometry.a)))
    yield "]"
    tolerance = layout.tolerance
    yield from ("", "[mechanism.tolerance]", f"a_mm = {tolerance.a_mm}", f"b_mm = {tolerance.b_mm}")
    if len(layout.geometry.u):
        yield f"u = {tolerance.u}"
    yield f"length_mm = {tolerance.length_mm}"
    yield from ("", "[noise]", f"point_mm = {declared_sigma(layout.noise)[0]:.7g}")
    declared = layout.noise.declared_actuator_mm
    yield f"actuator_mm = {layout.noise.actuator_mm if declared is None else declared}"
    if layout.weight is not None:
        yield from ("", "[measurement]", f"up = {_vector(np.array(layout.weight.up), 9)}")
    yield from layout.further_sections


def _leg(campaign: Campaign, i: int) -> str:
    g = campaign.layout.geometry
    parts = [f"a_mm = {_vector(g.a[i])}", f"b_mm = {_vector(g.b[i])}"]
    if len(g.u):
        parts.append(f"u = {_vector(g.u[i], 9)}")
    parts += [f"length_mm = {g.length[i]}", f"rho0_mm = {g.rho0[i]}"]
    if g.flexure_length is not None:
        parts.append(f"flexure_length_mm = {g.flexure_length}")
    return "{ " + ", ".join(parts) + " }"


def _vector(values: Array, decimals: int = 6) -> str:
    # Adding zero turns a rounded -0.0 into 0.0, which is what a person would write.
    return "[" + ", ".join(str(float(np.round(value, decimals)) + 0.0) for value in values) + "]"
