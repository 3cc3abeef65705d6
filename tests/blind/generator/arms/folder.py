"""Writes a campaign of an arm as a folder by the campaign format, and the truth next to it."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.blind.generator.arms.arm import Link
from tests.blind.generator.arms.draw import ArmCampaign
from tests.blind.generator.arms.effects import parameters
from tests.blind.generator.arms.notation import half_turn_vector, mechanism_lines, urdf
from tests.blind.generator.arms.schedule import Schedule
from tests.blind.generator.arms.transforms import Array

REFERENCE_C = 20.0


def write(
    campaign: ArmCampaign, folder: Path | str, name: str | None = None, certificate: tuple[str, ...] = ()
) -> Path:
    """Write the campaign folder, and ``<folder>.truth.json`` next to it; return the folder.

    ``certificate``: lines of campaign.toml that follow [campaign].
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    bench, instrument = campaign.bench, campaign.bench.instrument
    (folder / "campaign.toml").write_text(settings_text(campaign, name or folder.name, certificate), encoding="utf-8")
    if bench.design.notation == "urdf":
        arm = bench.design.arm
        if not bench.design.tells_masses:
            arm = replace(arm, links=tuple(Link(link.name) for link in arm.links))
        text = urdf(arm, campaign.layout, on_floor=campaign.layout in ("gantry", "two-tips"))
        (folder / "robot.urdf").write_text(text, encoding="utf-8")
    _write(folder / "configurations.csv", _configurations(campaign))
    if instrument.targets:
        _write(folder / "targets.csv", _targets(campaign))
    tables = {"points": _points, "poses": _poses, "distances": _distances}
    _write(folder / f"{instrument.kind}.csv", tables[instrument.kind](campaign))
    if instrument.kind == "points" and len(instrument.stations):
        _write(folder / "distances.csv", _distances(campaign))
    beside = folder.with_name(folder.name + ".truth.json")
    beside.write_text(json.dumps(truth(campaign), indent=1) + "\n", encoding="utf-8")
    return folder


def truth(campaign: ArmCampaign) -> dict[str, object]:
    """Hidden effects of a campaign, in SI units."""
    bench, instrument = campaign.bench, campaign.bench.instrument
    effects = []
    for effect in campaign.effects:
        entry: dict[str, object] = {"cause": effect.cause, "subject": effect.subject, "strength": effect.strength}
        if effect.cause == "foreign":
            entry |= {key: effect.fixed[key] for key in ("kind", "inputs") if key in effect.fixed}
        effects.append({**entry, "parameters": parameters(effect, bench.design.arm)})
    places = [joint.origin.tolist() for joint in campaign.arm.joints]
    return {
        "seed": campaign.seed,
        "layout": campaign.layout,
        "notation": bench.design.notation,
        "instrument": instrument.kind,
        "frame": instrument.frame,
        "effects": effects,
        "joint_places": dict(zip([joint.name for joint in campaign.arm.joints], places, strict=True)),
        "base_places": {"rotation": instrument.base[0].tolist(), "position_m": instrument.base[1].tolist()},
        "target_places_m": {target.name: target.place.tolist() for target in instrument.targets},
        "stations_m": instrument.stations.tolist(),
    }


def settings_text(campaign: ArmCampaign, name: str, certificate: tuple[str, ...] = ()) -> str:
    """campaign.toml of a campaign."""
    bench, arm, instrument = campaign.bench, campaign.bench.design.arm, campaign.bench.instrument
    lines = ["format = 1", "[campaign]", f'name = "{name}"', 'kind = "photogrammetry"', *certificate]
    lines += ["", "[mechanism]"]
    lines += ['type = "chain"', *mechanism_lines(bench.design), f'base = "{arm.links[0].name}"']
    lines += [f'closure = "{arm.loops.closure}"'] if arm.loops is not None else []
    lines += [f'tip = "{arm.links[arm.tips[0]].name}"', f"joints = {json.dumps(arm.names())}"]
    lines += [f"gravity = {[float(v) + 0.0 for v in arm.gravity]}", f"reference_temperature_c = {REFERENCE_C}"]
    if arm.payload:
        centre = [round(1e3 * float(v), 4) + 0.0 for v in arm.payload_com]
        lines += [f"payload_kg = {arm.payload!r}", f"payload_com_mm = {centre}"]
    if bench.tolerance is not None:
        own = bench.tolerance
        lines += ["", "[mechanism.tolerance]", f"offset_deg = {_text(np.degrees(own.offset))}"]
        lines += [f"length_mm = {_text(1e3 * own.length)}", f"angle_deg = {_text(np.degrees(own.angle))}"]
    lines += ["", "[measurement]", f'frame = "{instrument.frame}"']
    if instrument.kind == "poses" and instrument.rotations == "euler":
        lines += ["", "[poses]", f'euler = "{instrument.euler}"']
    lines += ["", "[noise]", f"point_mm = {_text(1e3 * instrument.noise)}"]
    for kind, key, factor in (("revolute", "joint_deg", np.degrees(1.0)), ("prismatic", "joint_mm", 1e3)):
        sigma = [s for k, s in enumerate(bench.joint_noise) if bench.joint_kind(k) == kind and s > 0.0]
        lines += [f"{key} = {_text(factor * sigma[0])}"] if sigma else []
    return "\n".join(lines) + "\n"


def _text(value: float) -> str:
    return repr(round(float(value), 9))


Lines = Iterable[Sequence[object]]


def _write(path: Path, lines: Lines) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows(lines)


def joint_columns(campaign: ArmCampaign) -> dict[str, str]:
    """Column of configurations.csv of each actuated joint, by the joint's name."""
    turn, bench = "rad" if campaign.seed % 4 == 0 else "deg", campaign.bench
    units = ["mm" if bench.joint_kind(k) == "prismatic" else turn for k in range(campaign.readings.shape[1])]
    return {name: f"{name}_{unit}" for name, unit in zip(bench.design.arm.names(), units, strict=True)}


def _configurations(campaign: ArmCampaign) -> Lines:
    bench, schedule = campaign.bench, campaign.bench.schedule
    columns = list(joint_columns(campaign).values())
    per_si = {"mm": 1e3, "rad": 1.0, "deg": float(np.degrees(1.0))}
    factor = np.array([per_si[column.rpartition("_")[2]] for column in columns])
    parted = bool(schedule.series[-1]) or bench.instrument.frame == "series"
    waits = any(effect.cause == "joint-settling" for effect in campaign.effects)
    heads = ["pose", "role", "time_s", *(["since_motion_s"] if waits else []), *(["series"] if parted else [])]
    yield [*heads, *columns, "temperature_c"]
    for n, row in enumerate(campaign.readings):
        role = "verification" if schedule.held_out[n] else "calibration"
        part = [f"{schedule.waits[n]:.2f}"] if waits else []
        part += [_series(schedule, n)] if parted else []
        values = [f"{value:.8f}" for value in row * factor]
        yield [n + 1, role, f"{schedule.time[n]:.1f}", *part, *values, f"{REFERENCE_C + schedule.warmth[n]:.4f}"]


def _series(schedule: Schedule, pose: int) -> str:
    return f"day-{schedule.series[pose] + 1}"


def _targets(campaign: ArmCampaign) -> Lines:
    arm = campaign.bench.design.arm
    yield ["body", "target", "x_mm", "y_mm", "z_mm"]
    for target, place in zip(campaign.bench.instrument.targets, campaign.survey, strict=True):
        known = [f"{1e3 * value:.5f}" for value in place] if target.surveyed else ["", "", ""]
        yield [arm.links[target.link].name, target.name, *known]


def _points(campaign: ArmCampaign) -> Lines:
    arm, instrument = campaign.bench.design.arm, campaign.bench.instrument
    yield ["pose", "body", "target", "x_mm", "y_mm", "z_mm"]
    for n, points in enumerate(campaign.recorded.points):
        for m, target in enumerate(instrument.targets):
            if instrument.is_observed[n, m]:
                yield [n + 1, arm.links[target.link].name, target.name, *(f"{1e3 * v:.5f}" for v in points[m])]


def _poses(campaign: ArmCampaign) -> Lines:
    arm, instrument, is_observed = campaign.bench.design.arm, campaign.bench.instrument, campaign.recorded
    heads, turns = rotation_columns(is_observed.turned, instrument.rotations, instrument.euler)
    sigmas = [f"{1e3 * instrument.noise:.6f}"] * 3 + [f"{instrument.turn_noise:.9f}"] * 3
    names = ["sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad"]
    yield ["pose", "body", "x_mm", "y_mm", "z_mm", *heads, *names]
    for n, place in enumerate(is_observed.moved):
        values = [*(f"{1e3 * v:.5f}" for v in place), *(f"{v:.10f}" for v in turns[n])]
        yield [n + 1, arm.links[arm.tips[0]].name, *values, *sigmas]


def _distances(campaign: ArmCampaign) -> Lines:
    instrument, is_observed = campaign.bench.instrument, campaign.recorded
    count = len(instrument.targets)
    yield ["pose", "from", "to", "distance_mm", "sigma_mm"]
    for n, distances in enumerate(is_observed.distances):
        for k, distance in enumerate(distances):
            if instrument.is_observed[n, k % count]:
                ends = [f"station:S{k // count + 1}", instrument.targets[k % count].name]
                yield [n + 1, *ends, f"{1e3 * distance:.5f}", f"{1e3 * instrument.noise:.6f}"]


def rotation_columns(turned: Array, style: str, euler: str) -> tuple[list[str], Array]:
    """Columns and values (N, 3 or 4) of rotations (N, 3, 3) in one of the styles."""
    vectors = np.stack([half_turn_vector(own) for own in turned])
    if style == "quaternion":
        half = np.linalg.norm(vectors, axis=1, keepdims=True) / 2.0
        return ["qw", "qx", "qy", "qz"], np.concatenate([np.cos(half), vectors / 2.0 * np.sinc(half / np.pi)], 1)
    if style == "rotation vector":
        return ["rx_rad", "ry_rad", "rz_rad"], vectors
    return ["euler_a_deg", "euler_b_deg", "euler_c_deg"], np.degrees(euler_angles(turned, euler))


def euler_angles(turned: Array, order: str) -> Array:
    """Angles (N, 3) of rotations (N, 3, 3): capitals about turned axes, small letters about fixed ones."""
    R = np.moveaxis(turned, 0, -1)
    if order == "XYZ":
        return np.stack([np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(R[0, 2]), np.arctan2(-R[0, 1], R[0, 0])], -1)
    if order == "ZYZ":
        return np.stack([np.arctan2(R[1, 2], R[0, 2]), np.arccos(R[2, 2]), np.arctan2(R[2, 1], -R[2, 0])], -1)
    turns = np.stack([np.arctan2(R[1, 0], R[0, 0]), -np.arcsin(R[2, 0]), np.arctan2(R[2, 1], R[2, 2])], -1)
    return turns if order == "ZYX" else turns[:, ::-1]
