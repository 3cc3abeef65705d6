"""Writes a campaign as the folder that the campaign format describes, and the truth next to the folder."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tests.blind.generator.folder import truth_path
from tests.blind.generator.quaternions import Array
from tests.blind.generator.sensor.campaign import Campaign, truth_record
from tests.blind.generator.sensor.elements import Element
from tests.blind.generator.sensor.layout import ARCSEC, AXES, CHANNELS, FILE_UNIT, LOADS
from tests.blind.generator.sensor.schedule import COLUMNS

SIX = ("dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad")
AIR_DECIMALS = (3, 2, 1, 3)


def write_campaign(campaign: Campaign, folder: Path, seed: int) -> Path:
    """Fills ``folder`` (made where missing) and writes ``<folder>.truth.json`` next to it; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / "campaign.toml", _campaign_toml(campaign))
    if campaign.layout.written_as == "displacement":
        _write(folder / "displacement.csv", _displacement(campaign))
    else:
        _write(folder / "interferometer.csv", _interferometer(campaign))
    if campaign.layout.signals:
        _write(folder / "signals.csv", _signals(campaign))
    if campaign.layout.compliance_given:
        _write(folder / "compliance.csv", (_numbers(row, ".9e") for row in campaign.given.compliance))
    _write(truth_path(folder), [json.dumps(truth_record(campaign, seed), indent=1)])
    return folder


def _write(path: Path, lines: Iterable[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _interferometer(campaign: Campaign) -> Iterable[str]:
    heads, roles, air = _common(campaign)
    yield f"run,step,time_s,{heads}channel,reading{_role_head(campaign)}{_air_head(campaign)}"
    for n in range(len(campaign.schedule.run)):
        for k in np.flatnonzero(campaign.is_observed[n]):
            reading = f"{campaign.readings[n, k] / FILE_UNIT[k]:.4f}"
            yield f"{_step(campaign, n)},{_load(campaign, n)},{CHANNELS[k]},{reading}{roles[n]}{air[n]}"


def _displacement(campaign: Campaign) -> Iterable[str]:
    heads, roles, air = _common(campaign)
    yield f"run,step,time_s,{heads}{','.join(SIX)}{_role_head(campaign)}{_air_head(campaign)}"
    for n in np.flatnonzero(campaign.is_observed.any(axis=1)):
        values = campaign.readings[n] * ([1e3] * 3 + [1.0] * 3)
        six = (
            f"{value:.8f}" if is_observed else ""
            for value, is_observed in zip(values, campaign.is_observed[n], strict=True)
        )
        yield f"{_step(campaign, n)},{_load(campaign, n)},{','.join(six)}{roles[n]}{air[n]}"


def _signals(campaign: Campaign) -> Iterable[str]:
    heads, roles, _ = _common(campaign)
    names = ",".join(f"v{c + 1}_mv" for c in range(campaign.layout.signals))
    yield f"run,step,{heads}{names}{_role_head(campaign)}"
    for n in range(len(campaign.schedule.run)):
        run, step = campaign.schedule.run[n], campaign.schedule.step[n]
        yield f"{run},{step},{_load(campaign, n)},{_numbers(campaign.signals[n], '.5f')}{roles[n]}"


def _common(campaign: Campaign) -> tuple[str, list[str], list[str]]:
    """Heads of the load's columns; per step the role and the air as they end a row."""
    heads = ",".join(LOADS) + "," if campaign.layout.programme.together else "load_axis,load,"
    roles = [f",{role}" if _role_head(campaign) else "" for role in campaign.schedule.role]
    air = [
        "".join(f",{value:.{decimals}f}" for value, decimals in zip(row, AIR_DECIMALS, strict=True))
        if _air_head(campaign)
        else ""
        for row in campaign.schedule.air
    ]
    return heads, roles, air


def _role_head(campaign: Campaign) -> str:
    return ",role" if any(campaign.schedule.role) else ""


def _air_head(campaign: Campaign) -> str:
    return "".join(f",{name}" for name in COLUMNS) if campaign.layout.surroundings.recorded else ""


def _step(campaign: Campaign, n: int) -> str:
    schedule = campaign.schedule
    return f"{schedule.run[n]},{schedule.step[n]},{schedule.time_s[n]:.1f}"


def _load(campaign: Campaign, n: int) -> str:
    schedule = campaign.schedule
    if campaign.layout.programme.together:
        return ",".join(f"{value + 0.0:g}" for value in schedule.load[n])
    own = schedule.load[schedule.run == schedule.run[n]]
    axis = int(np.flatnonzero(np.any(own, axis=0))[0])
    return f"{AXES[axis]},{schedule.load[n, axis] + 0.0:g}"


def _numbers(values: Array, form: str) -> str:
    return ",".join(f"{value:{form}}" for value in values)


def _campaign_toml(campaign: Campaign) -> Iterable[str]:
    layout = campaign.layout
    yield "format = 1"
    yield from ("", "[campaign]", f'name = "{layout.name}"', 'kind = "interferometer"', *layout.certificate)
    yield from ("", "[mechanism]", 'type = "6-upur"')
    yield f"reference_temperature_c = {layout.surroundings.reference_temperature_c}"
    yield "legs = ["
    pairs = zip(layout.sensor.lower_mm, layout.sensor.upper_mm, strict=True)
    yield from (f"  {{ B_mm = {_vector(B)}, b_mm = {_vector(b)} }}," for B, b in pairs)
    yield from ("]", f"height_mm = {layout.sensor.height_mm}")
    if layout.compliance_given:
        yield 'compliance_file = "compliance.csv"'
    else:
        yield "elements = ["
        yield from (f"  {_element(element)}," for element in layout.sensor.elements)
        yield "]"
    if layout.stated_range:
        yield from ("", "[loading]", *(f"{name} = {limit}" for name, limit in zip(LOADS, layout.range, strict=True)))
    yield from ("", "[mechanism.tolerance]", *_tolerance(campaign))
    optics = layout.interferometer
    yield from ("", "[interferometer]", f"wavelength_nm = {1e9 * optics.wavelength:.6f}")
    yield f"dead_path_mm = {1e3 * optics.dead_path:g}"
    yield f"compensated = {str(optics.compensated).lower()}"
    yield from ("", "[noise]", *_noise(campaign))


def _tolerance(campaign: Campaign) -> Iterable[str]:
    for name, value in vars(campaign.layout.tolerance).items():
        if name not in ("stiffness", "common") and not campaign.layout.compliance_given:
            yield f"{name}_um = {1e6 * value:g}"
    if campaign.layout.tolerance.stiffness:
        yield f"stiffness = {campaign.layout.tolerance.stiffness:g}"


def _noise(campaign: Campaign) -> Iterable[str]:
    noise = campaign.layout.noise
    if campaign.layout.written_as == "displacement":
        yield from (f"displacement_mm = {1e3 * noise.linear:.7g}", f"rotation_rad = {noise.angular:.7g}")
    else:
        yield from (f"linear_um = {1e6 * noise.linear:.7g}", f"angular_arcsec = {noise.angular / ARCSEC:.7g}")
    if campaign.layout.signals:
        yield f"signal_mv = {noise.signal_mv:g}"
    if noise.force or noise.torque:
        yield from (f"load_n = {noise.force:g}", f"load_nm = {noise.torque:g}")


def _element(element: Element) -> str:
    parts = [f'kind = "{element.kind}"']
    if element.length_mm and element.kind != "notch":
        parts.append(f"length_mm = {element.length_mm}")
    parts += [f"{name} = {value}" for name, value in element.numbers.items()]
    if element.soft:
        parts.append(f'soft = "{element.soft}"')
    if element.matrix is not None:
        rows = ", ".join(f"[{_numbers(row + 0.0, '.9e')}]" for row in element.matrix)
        parts.append(f"matrix = [{rows}]")
    return "{ " + ", ".join(parts) + " }"


def _vector(values: Array) -> str:
    # Adding zero turns a rounded -0.0 into 0.0, which is what a person would write.
    return "[" + ", ".join(str(float(np.round(value, 6)) + 0.0) for value in values) + "]"
