"""Interferometer logs of a laboratory and of an axis under test: arrays and derived facts."""

from __future__ import annotations

import gzip
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truing.estimation.interferometry.iso230 import FORWARD, Positioning, positioning, positioning_uncertainty
from truing.estimation.interferometry.log_quality import saturated, surroundings
from truing.estimation.interferometry.quadrature import (
    EllipseFit,
    corrected,
    fit_ellipse,
    residual_radius,
    uncorrected_error,
)
from truing.schemas.quality_checks import settable
from truing.simulation.air import ciddor_index, vapour_pressure_pa

AXES = ("X", "Y", "Z")
LENGTH_PER_TURN_NM = 632.99 / 2.0  # a plane mirror, light back and forth once
_ROUND = settable("interferometer")["signals-round"].fail or 0.0  # of the mean radius


def quadrature(folder: Path) -> NDArray[np.float64]:
    """Signals (3, N, 2) of the axes X, Y, Z in steps of the converter, made of phase and radius as published."""
    out = []
    for axis in AXES:
        degrees, radius = _columns(folder / "sios-nmm-quadrature" / f"test01_XYZ_f_quad_{axis}_raw.csv.gz")
        p = np.radians(degrees)
        exact = radius[:, None] * np.stack([np.cos(p), np.sin(p)], -1)
        out.append(np.round(exact))
    return np.array(out)


def published_radius(folder: Path, kind: str) -> NDArray[np.float64]:
    """Standard deviation of the radius (3,) as published: raw, Heydemann or MatusDai."""
    files = (folder / "sios-nmm-quadrature" / f"test01_XYZ_f_quad_{axis}_{kind}.csv.gz" for axis in AXES)
    return np.array([np.std(_columns(file)[1]) for file in files])


def _columns(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    with gzip.open(path, "rt", encoding="ascii") as file:
        table = np.loadtxt(file, delimiter=",", skiprows=1, usecols=(0, 1))
    return table[:, 0], table[:, 1]


@dataclass(frozen=True)
class QuadratureFacts:
    """Of each axis: radius' standard deviation before, after, and after without what the converter cut off."""

    raw: NDArray[np.float64]
    corrected: NDArray[np.float64]
    unclipped: NDArray[np.float64]
    mean_radius: NDArray[np.float64]
    clipped_share: NDArray[np.float64]
    flagged: NDArray[np.bool_]
    periodic_nm: NDArray[np.float64]
    fourth_wave: NDArray[np.float64]
    fit: EllipseFit
    kept_fit: EllipseFit


def quadrature_facts(signals: NDArray[np.float64]) -> QuadratureFacts:
    """Correct the three axes as they are, and without samples at the converter's ends."""
    wall = np.array(
        [[np.isin(np.arange(axis.shape[0]), saturated(axis[:, k]).where) for k in (0, 1)] for axis in signals]
    )
    kept = ~wall.any(1)
    fit, kept_fit = fit_ellipse(signals), fit_ellipse(signals, kept)
    radius = np.linalg.norm(signals, axis=-1)
    left = residual_radius(signals, fit.values)
    turn = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    return QuadratureFacts(
        raw=radius.std(1),
        corrected=left,
        unclipped=residual_radius(signals, kept_fit.values, kept),
        mean_radius=radius.mean(1),
        clipped_share=1.0 - kept.mean(1),
        flagged=left > _ROUND * radius.mean(1),
        periodic_nm=np.abs(uncorrected_error(kept_fit.values, turn)).max(1) / (2 * np.pi) * LENGTH_PER_TURN_NM,
        fourth_wave=_radius_waves(signals, kept_fit.values, 4, kept)[:, 3],
        fit=fit,
        kept_fit=kept_fit,
    )


def _radius_waves(signals: NDArray, values: NDArray, orders: int, used: NDArray | None = None) -> NDArray:
    """Return the amplitudes (B, orders) of the waves 1, 2, ... per fringe that the corrected radius keeps, relative.

    A true ellipse leaves none; waves of order 4 are those of signals that are not sines, such as clipped ones.
    """
    circle = corrected(signals, values)
    radius = np.linalg.norm(circle, axis=-1)
    p = np.arctan2(circle[..., 1], circle[..., 0])
    weight = np.ones_like(p) if used is None else np.broadcast_to(used, p.shape).astype(float)
    angle = p[..., None] * np.arange(1, orders + 1)
    design = np.concatenate([np.ones_like(p)[..., None], np.cos(angle), np.sin(angle)], -1)
    weighted = np.swapaxes(design * weight[..., None], 1, 2)
    found = np.linalg.pinv(weighted @ design, hermitian=True) @ (weighted @ radius[..., None])
    return np.hypot(found[:, 1 : orders + 1, 0], found[:, orders + 1 :, 0])


def surroundings_facts(folder: Path) -> dict[str, float]:
    """The air of the scan: its index at the start, how far that went over the scan, and by how much each part of it."""
    name = "sios-nmm-quadrature/test01_XYZ{}.pos"
    lines = np.concatenate([np.loadtxt(folder / name.format(way))[:, 3:8] for way in ("", "b")])
    warm, pascal = lines[:, :3].mean(1), lines[:, 3]
    vapour = vapour_pressure_pa(warm, 0.01 * lines[:, 4])  # taken for the humidity, as its size suggests
    found = surroundings(ciddor_index(632.99e-9, warm, pascal, vapour), np.zeros(len(lines), int))
    return {
        "index": float(found.first[0]),
        "span": float(found.span[0]),
        "pressure_pa": float(np.ptp(pascal)),
        "temperature_k": float(np.ptp(warm)),
    }


def slit(folder: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Targets (5,) and deviations (5, 2, 5) in mm, forward being the report's forward: the data file's backward."""
    text = (folder / "ess-slit-iso230" / "example_data_ISO230_2.dat").read_text(encoding="ascii")
    target = np.array([float(value) for value in re.findall(r"^TGT_DATA\[\d+\]=(\S+)", text, re.MULTILINE)])
    actual = np.full((len(target), 2, 5), np.nan)
    for way, position, cycle, value in re.findall(r"^REF_DATA_(FWD|BWD)\[(\d+),(\d+)\]=(\S+)", text, re.MULTILINE):
        actual[int(position) - 1, {"BWD": FORWARD, "FWD": 1}[way], int(cycle) - 1] = float(value)
    return target, actual - target[:, None, None]


def slit_report(folder: Path) -> dict[str, Any]:
    """Printed report of the laboratory: lines of the axis by name, and tables by the head of their first column."""
    text = (folder / "ess-slit-iso230" / "example_report_ISO230_2.md").read_text(encoding="utf-8")
    lines = {name: float(value) for name, value in re.findall(r"^(\w+) = (-?[\d.e-]+) \[mm\]", text, re.MULTILINE)}
    tables: dict[str, NDArray[np.float64]] = {}
    for block in re.findall(r"^(i \|.*(?:\n.*\|.*)+)", text, re.MULTILINE):
        rows = block.split("\n")
        numbers = [[float(cell) for cell in row.strip("|").split("|")] for row in rows[2:] if row[0].isdigit()]
        tables.setdefault(rows[0], np.array(numbers)[:, 1:])
        tables[rows[0] + " again"] = np.array(numbers)[:, 1:]
    return {"lines": lines, "tables": tables}


LINES = {
    "B": lambda own: own.reversal,
    "B_avg": lambda own: own.mean_reversal,
    "R_fwd": lambda own: own.repeatability[0],
    "R_bwd": lambda own: own.repeatability[1],
    "R": lambda own: max(own.repeatability),
    "E_fwd": lambda own: own.systematic[0],
    "E_bwd": lambda own: own.systematic[1],
    "E": lambda own: own.bidirectional_systematic,
    "M": lambda own: own.mean_deviation,
    "A_fwd": lambda own: own.accuracy[0],
    "A_bwd": lambda own: own.accuracy[1],
    "A": lambda own: own.bidirectional_accuracy,
}


def slit_facts(folder: Path) -> dict[str, Any]:
    """The axis by our formulas, line by line next to the report, and what is wrong in it."""
    target, deviation = slit(folder)
    own: Positioning = positioning(deviation)
    report = slit_report(folder)["lines"]
    ours = {name: float(of(own)) for name, of in LINES.items()}
    return {
        "own": own,
        "ours": ours,
        "report": report,
        "wrong": [name for name in LINES if abs(ours[name] - report[name]) > 0.6e-5],
        # what the wrong line is: the highest mean of one direction less the lowest of the other
        "as_printed": float(own.mean[:, 1].max() - own.mean[:, 0].min()),
        "standard_r": float(own.bidirectional_repeatability),
        "uncertainty": positioning_uncertainty(deviation, target, np.random.default_rng(230)),
    }


def strange_axis(folder: Path) -> dict[str, float]:
    """The axis that its testers marked as strange: how much of its error is one offset of the sensor, mm."""
    text = (folder / "ess-slit-iso230" / "slits_11359_axis1_report.md").read_text(encoding="utf-8")
    parts = re.split(r"^## ", text, flags=re.MULTILINE)
    accuracy = next(part for part in parts if part.startswith("Accuracy based on") and "Positive" in part)
    rows = re.findall(r"^\d+ \|(.+)$", accuracy, re.MULTILINE)
    cells = np.array([[float(cell) for cell in row.split("|")[:4]] for row in rows if "range" not in row])
    off = cells[:, 3] - cells[:, 0]
    again = {}
    for at in (15, 35, 55):
        part = next(p for p in parts if p.startswith(f"Target Position {at} "))
        again[at] = float(re.findall(r"^AVG \| ([\d.]+)", part, re.MULTILINE)[-1]) - at
    moved = [float(off[cells[:, 0] == at][0]) - again[at] for at in again]
    return {
        "largest": float(np.abs(off).max()),
        "offset": float(off.mean()),
        "systematic": float(np.ptp(off)),
        "moved_least": float(np.max(moved)),
        "moved_most": float(np.min(moved)),
    }
