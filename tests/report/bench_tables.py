"""Synthetic tables of a force sensor's bench: one channel per run, loads up and down."""

from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd

from tests.report.diagnosis_tables import row, rows, size

LOADS = {"fx": "fx_n", "fy": "fy_n", "fz": "fz_n", "mx": "mx_nm", "my": "my_nm", "mz": "mz_nm"}
NOISE = {"dx": 0.5, "dy": 0.5, "dz": 0.5, "rx": 0.2, "ry": 0.2, "rz": 0.2}
UNITS = {channel: "um" if channel[0] == "d" else "arcsec" for channel in NOISE}
LEVELS = np.array([0.0, 3.0, 6.0, 9.0, 6.0, 3.0, 0.0, -3.0, -6.0, -9.0, -6.0, -3.0, 0.0])
AXES, CHANNELS = ("fx", "fz", "mx"), ("dx", "dz", "rx", "ry")
# What the eccentric z load does to the rotations, arcsec per kN.
PER_KN = {"rx": 0.6, "ry": 1.0}


def bench_tables(diagnosis: pd.DataFrame | None = None, *, held: int = 0, signals: int = 6) -> dict[str, pd.DataFrame]:
    """A whole run on a bench; the last ``held`` runs are held out."""
    readings = _readings(held)
    found = row("load-eccentricity", subject="load fz", parameters=OFFSETS, **MISSED)
    tables = {
        "readings": readings,
        "diagnosis": rows(found, *rejected()) if diagnosis is None else diagnosis,
        "reading_errors": _errors(readings),
        "detectable": detectable(),
        "qa": pd.DataFrame(
            [("zero-return", "run 4", 1.2, 3.0, "um", "pass", "Run 4 comes back to zero.", None)],
            columns=["check", "subject", "value", "limit", "unit", "verdict", "message", "accepted"],
        ),
    }
    return {**tables, "signals": _signals(readings, signals)} if signals else tables


OFFSETS = {"offset_x": size(12.03, 0.04, "mm"), "offset_y": size(-7.98, 0.05, "mm")}
MISSED = {
    "rms_before": 4.1,
    "rms_after": 0.21,
    "heldout_rms_before": 4.2,
    "heldout_rms_after": 0.22,
    "noise_floor": 0.2,
    "unit": "arcsec",
    "next_measurement": "Shift the load fz by a known millimetre.",
}


def rejected() -> list[dict]:
    """Rows of causes that are usually rejected."""
    causes = ("stiffness-scale", "hysteresis", "creep", "zero-drift", "thermal-drift", "cosine-error", "crosstalk")
    return [row(cause, "rejected", unit="um", relation="loads-readings") for cause in causes]


def detectable() -> pd.DataFrame:
    """detectable.parquet: causes by load and by channel, in several units."""
    found = [("load-eccentricity", f"load {axis}", "offset_x", 0.1 + 0.01 * k, "mm") for k, axis in enumerate(AXES[:2])]
    found += [("load-eccentricity", "load mx", "force_x", 0.02, "1/m")]
    found += [("stiffness-scale", f"load {axis}", "scale", 0.004, "1") for axis in AXES]
    found += [("zero-drift", f"channel {c}", "rate", 0.8, f"{UNITS[c]}/h") for c in CHANNELS]
    found += [("creep", "", "fraction", np.nan, "1")]
    return pd.DataFrame(found, columns=["cause", "subject", "parameter", "size", "unit"]).assign(power=0.8)


def _readings(held: int) -> pd.DataFrame:
    rng = np.random.default_rng(5)
    runs = list(product(AXES, CHANNELS))
    parts = []
    for run, (axis, channel) in enumerate(runs, 1):
        step = np.arange(len(LEVELS))
        part = pd.DataFrame({"run": run, "step": step, "time_s": 3000.0 * run + 60.0 * step})
        load = LEVELS * (1000.0 if axis[0] == "f" else 500.0)
        part = part.assign(**{column: load if name == axis else 0.0 for name, column in LOADS.items()})
        reading = load * 1e-2 + NOISE[channel] * rng.standard_normal(len(step))
        role = "verification" if run > len(runs) - held else "calibration"
        part = part.assign(channel=channel, reading=reading, unit=UNITS[channel], sigma=NOISE[channel], role=role)
        parts.append(part.assign(air_temperature_c=20.0 + 0.01 * run, material_temperature_c=np.nan))
    return pd.concat(parts, ignore_index=True)


def _errors(readings: pd.DataFrame) -> pd.DataFrame:
    rng = np.random.default_rng(7)
    after = readings["sigma"] * rng.standard_normal(len(readings))
    moved = readings["channel"].map(PER_KN).fillna(0.0) * readings["fz_n"] / 1000.0
    table = readings[["run", "step", "channel", "role"]]
    missed = {"missed_before": after + moved, "missed_after": after, "noise_floor": readings["sigma"]}
    return table.assign(**missed, unit=readings["unit"])


def _signals(readings: pd.DataFrame, count: int) -> pd.DataFrame:
    table = readings.drop(columns=["channel", "reading", "unit", "sigma"])
    forces = readings[list(LOADS.values())].to_numpy() @ np.random.default_rng(9).standard_normal((6, count))
    return table.assign(**{f"v{k + 1}_mv": 1e-3 * forces[:, k] for k in range(count)})
