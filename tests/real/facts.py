"""Every figure of docs/real-data.md, computed from the tables of the runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from tests.real import force_facts
from tests.real.diagnosed import diagnosed, length, sag, seen_in_between, up_and_down, walked
from truing.estimation.interferometry.recorded_steps import READING_SI
from truing.estimation.response import fit_response
from truing.estimation.rigid_poses.umeyama import umeyama
from truing.estimation.rotation import exp_so3

Tables = dict[str, pd.DataFrame]

KIP_N, INCH_M = 4448.2216152605, 0.0254


def defaults(tables: Tables) -> pd.DataFrame:
    poses = tables["poses"]
    return poses[poses["default"]]


def spread_um(tables: Tables, body: str) -> dict[str, float]:
    """Median, 95th percentile and maximum of a body's rigid-fit rms, in um, over the poses that could be determined."""
    rows = defaults(tables)
    rms = 1e3 * rows.loc[(rows["body"] == body) & rows["rms_mm"].notna(), "rms_mm"]
    return {"poses": len(rms), "median": rms.median(), "p95": rms.quantile(0.95), "max": rms.max()}


def rejected(tables: Tables) -> dict[str, list[str]]:
    """Targets kept out as gross errors, with their poses."""
    rows = tables["residuals"][tables["residuals"]["rejected"]]
    return {str(target): [str(p) for p in part["pose"]] for target, part in rows.groupby("target", sort=True)}


def irb120(tables: Tables) -> dict[str, Any]:
    qa = tables["qa"].set_index("check")
    base = tables["observations"][tables["observations"]["body"] == "base"]
    bad = tables["residuals"][tables["residuals"]["rejected"]][["pose", "target"]]
    good = base.merge(bad, on=["pose", "target"], how="left", indicator=True).query("_merge == 'left_only'")
    drift = {}
    for target, rows in good.sort_values("pose").groupby("target"):
        xyz = rows[["x_mm", "y_mm", "z_mm"]].to_numpy()
        first, last = np.median(xyz[:25], axis=0), np.median(xyz[-25:], axis=0)
        drift[target] = 1e3 * float(np.linalg.norm(last - first))
    return {
        "points": len(tables["observations"]),
        "dropouts": int(tables["exclusions"]["rows"].sum()),
        "rejected": rejected(tables),
        "tool": spread_um(tables, "tool"),
        "base": spread_um(tables, "base"),
        "drift": drift,
        "drift_check": float(qa.loc["base-drift", "value"]) * 1e3,
    }


def elevation(tables: Tables) -> dict[str, Any]:
    """Elevation steps recovered from the poses, rigid fits to the first pose, and the linear deformation."""
    rows = defaults(tables).sort_values("pose")
    rotation = exp_so3(rows[["rx_rad", "ry_rad", "rz_rad"]].to_numpy())
    turned = np.degrees(_angle(rotation[:-1], rotation[1:]))
    rms = _to_first(tables["observations"])
    models, errors = tables["deformation_models"], tables["deformation_errors"]
    left = errors[(errors["figure"] == "rms_error")].set_index("model")["value"]
    return {
        "poses": len(rows),
        "steps": {"least": turned.min(), "mean": turned.mean(), "most": turned.max()},
        "total": float(np.degrees(_angle(rotation[:1], rotation[-1:]))[0]),
        "rms_first": {"least": rms.min(), "most": rms.max()},
        "significant": int(models["significant"].sum()),
        "coefficients": len(models),
        "rms_none": float(left["none"]),
        "rms_linear": float(left["linear"]),
    }


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    trace = np.einsum("bji,bji->b", first, second)
    return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))


def _to_first(observations: pd.DataFrame) -> np.ndarray:
    """Rigid-fit rms in um, per point, of every later pose against the first."""
    wide = observations.pivot(index="pose", columns="target", values=["x_mm", "y_mm", "z_mm"]).sort_index()
    points = wide.to_numpy().reshape(len(wide), 3, -1).transpose(0, 2, 1) * 1e-3
    fit = umeyama(np.broadcast_to(points[0], points[1:].shape), points[1:])
    return 1e6 * fit.rms


def vstars(tables: Tables) -> dict[str, Any]:
    rows = defaults(tables).set_index("pose")
    out = tables["residuals"][tables["residuals"]["rejected"]]
    size = np.sqrt((out[["dx_mm", "dy_mm", "dz_mm"]] ** 2).sum(axis=1))
    far = out.assign(size=size)[size > 10.0]
    per_pose = {str(p): sorted(part["target"], key=_code) for p, part in far.groupby("pose")}
    return {
        "sets": len(rows),
        "determined": int((rows["status"] == "ok").sum()),
        "codes": int(tables["observations"]["target"].nunique()),
        "rms_mm": {str(p): float(r) for p, r in rows["rms_mm"].items()},
        "used": {str(p): int(n) for p, n in rows["n_used"].items()},
        "rejected": len(out),
        "moved": per_pose,
        "metres": sorted({str(t) for t in far.loc[far["size"] > 1000.0, "target"]}, key=_code),
    }


def _code(name: str) -> int:
    return int(name.removeprefix("CODE"))


def mocap(tables: Tables) -> dict[str, Any]:
    bodies = list(dict.fromkeys(tables["observations"]["body"]))
    return {body: spread_um(tables, body) for body in bodies}


def lbcb(tables: Tables) -> dict[str, Any]:
    """Compliance by the deformation stage, and the stiffness of small displacements by the same model the other way."""
    errors = tables["deformation_errors"]
    shares = errors[(errors["model"] == "matrix") & (errors["figure"] == "r_squared")].set_index("subject")["value"]
    readings = tables["observations"]  # as they were read, before any is left out
    moved = readings.pivot(index="step", columns="channel", values="reading")
    loads = readings.drop_duplicates("step").set_index("step")
    small = moved["dx"].abs() < 0.3 * 25.4e3
    u = moved.loc[small, ["dx", "dy", "dz", "rx", "ry", "rz"]].to_numpy() * READING_SI
    y = loads.loc[moved.index[small], ["fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"]].to_numpy()
    fit = fit_response(u, y, np.tile(np.diag(y.var(axis=0)), (len(u), 1, 1)))
    r_squared = 1.0 - (fit.residuals**2).sum(axis=0) / ((y - y.mean(axis=0)) ** 2).sum(axis=0)
    return {
        "steps": len(moved),
        "compliance_r2": dict(shares),
        "small": int(small.sum()),
        "stiffness_r2": list(r_squared),
        "kxx_kip_per_in": float(fit.coefficients[0, 0]) / KIP_N * INCH_M,
        "fx_rms_kip": float(np.sqrt((fit.residuals[:, 0] ** 2).mean())) / KIP_N,
    }


_SHIFT = ("shift_x", "shift_y", "shift_z")


def still_bodies(tables: Tables) -> dict[str, Any]:
    """Motion of bodies that should stand still: by the diagnosis, and between first and last readings."""
    found = diagnosed(tables)
    moves = [
        row for row in found["found"] if "shift_x" in row["value"] and seen_in_between(row, tables["observations"])
    ]
    reported = {
        body: length(
            {axis: sum(row["value"][axis] for row in moves if row["subject"] == body) for axis in _SHIFT}, _SHIFT
        )
        for body in {row["subject"] for row in moves}
    }
    return {"diagnosis": found, "walked_mm": reported, "seen_mm": walked(tables["observations"])}


def mirror(tables: Tables) -> dict[str, Any]:
    """Elevation up and back: what stays between the two ways."""
    return {**elevation(tables), "both_ways": up_and_down(tables, "elevation_deg")}


def sagging(tables: Tables) -> dict[str, Any]:
    """Three readings at 90 degrees, three at 40, two at 90 again: rigid fits of one to another, um."""
    points = tables["observations"]
    return {"tipped": sag(points, (1, 4)), "back": sag(points, (1, 7)), "same": sag(points, (1, 2))}


def moved_codes(tables: Tables) -> dict[str, Any]:
    """Displacements of codes by the diagnosis, mm, by code and pose."""
    rows = [row for row in diagnosed(tables)["found"] if row["cause"] == "target-moved"]
    return {
        row["subject"].removeprefix("target "): (row["value"]["from_pose"], length(row["value"], ("dx", "dy", "dz")))
        for row in rows
    }


def irb120_and_its_base(tables: Tables) -> dict[str, Any]:
    """The robot, and how far its base walked."""
    return {**irb120(tables), **still_bodies(tables)}


FACTS = {
    "irb120-faro": irb120_and_its_base,
    "so-lat-elevation": lambda tables: {**elevation(tables), "diagnosis": diagnosed(tables)},
    "so-lat-mirror": lambda tables: {**mirror(tables), "diagnosis": diagnosed(tables)},
    "so-lat-sag": lambda tables: {**sagging(tables), "diagnosis": diagnosed(tables)},
    "so-lat-stability": still_bodies,
    "so-lat-sameday": lambda tables: {**vstars(tables), "diagnosis": diagnosed(tables)},
    "so-lat-epochs": lambda tables: {**vstars(tables), "diagnosis": diagnosed(tables)},
    "so-lat-vstars": lambda tables: {**vstars(tables), "diagnosis": diagnosed(tables), "moved_mm": moved_codes(tables)},
    "mocap-static": lambda tables: {"bodies": mocap(tables), "diagnosis": diagnosed(tables)},
    "mocap-full": lambda tables: {"bodies": mocap(tables), "diagnosis": diagnosed(tables)},
    "lbcb-pier": lambda tables: {**lbcb(tables), "small_loops": force_facts.pier(tables)},
    "fareke-file1": force_facts.weights,
    "fareke-file2": force_facts.weights,
    "fareke-file3": force_facts.weights,
    "sps01-stewart-force": force_facts.stewart,
    "optical-ft-ur3e": force_facts.optical,
    "sios-nmm-quadrature": force_facts.quadrature,
    "ess-slit-iso230": force_facts.positioning,
}
