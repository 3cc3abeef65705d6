"""The figures of docs/real-data.md on force sensors, drawn from the facts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tests.real.force_facts import LINEAR, PRODUCTS, SQUARES
from tests.real.page import PAGE
from tests.real.plots import Plot, Trace, write_plots
from truing.estimation.interferometry.quadrature import corrected, corrected_phase

FOLDER = PAGE.parent / "figures"
_FEWER = 80  # of so many samples of an interferometer one is drawn


def write_figures(
    facts: dict[str, dict[str, Any]], raw: dict[str, Any], signals: dict[str, Any], folder: Path = FOLDER
) -> None:
    """Write every figure, from the facts and an interferometer's raw signals."""
    for name, plots in {
        "real-pier": _pier(facts["lbcb-pier"]["small_loops"]),
        "real-fareke": _weights(facts),
        "real-stewart": _legs(facts["sps01-stewart-force"]),
        "real-optical": _optical(facts["optical-ft-ur3e"]["models"]),
        "real-quadrature": _quadrature(signals),
        "real-slit": _slit(raw["slit"]),
    }.items():
        write_plots(folder / f"{name}.svg", plots)


def _pier(pier: dict[str, Any]) -> list[Plot]:
    x, force = pier["moved"][1:, 0], pier["force"][1:, 0]  # the first reading was taken before the test
    small = np.flatnonzero(np.abs(x) > 0.3)[0]
    return [
        Plot("until it was moved by 0.3 in", "x, in", "force, kip", [Trace("steps", x[:small], force[:small], "line")]),
        Plot("all steps", "x, in", "force, kip", [Trace("steps", x, force, "line")]),
    ]


def _weights(facts: dict[str, dict[str, Any]]) -> list[Plot]:
    plots = []
    for number in (1, 2):
        left = np.array(facts[f"fareke-file{number}"]["residuals"]["fy"])
        rows = Trace("Fy less linear calibration", np.arange(1.0, len(left) + 1), left)
        plots.append(Plot(f"file {number}", "row", "N", [rows]))
    return plots


def _legs(found: dict[str, Any]) -> list[Plot]:
    legs = np.arange(6.0)
    plots = []
    for axis in ("Fx", "Fy", "Fz"):
        traces = [
            Trace("shown", legs, np.array(found["legs"][axis]), "bars"),
            Trace("by the load, through the origin", legs, np.array(found["applied"][axis]), "bars"),
            Trace("by the load, through the point found", legs, np.array(found["moved"][axis]), "bars"),
        ]
        plots.append(Plot(f"run {axis}", "leg", "N", traces, [str(leg + 1) for leg in range(6)]))
    return plots


def _optical(models: dict[str, Any]) -> list[Plot]:
    names = ("linear", "squares", "products")
    kinds = (("fitted", "rows fitted"), ("random", "random rows left out"), ("held_out", "whole runs left out"))
    at = np.arange(3.0)
    return [
        Plot(
            f"rms of {load}",
            "",
            "N",
            [
                Trace(title, at, np.array([models[name][kind][k] for name in (LINEAR, SQUARES, PRODUCTS)]), "bars")
                for kind, title in kinds
            ],
            names,
        )
        for k, load in enumerate(("Fx", "Fy", "Fz"))
    ]


def _quadrature(found: dict[str, Any]) -> list[Plot]:
    plots = []
    for k, axis in enumerate("XYZ"):
        signals, ellipse = found["signals"][k, ::_FEWER], found["fit"][k]
        phase = corrected_phase(signals, ellipse)
        radius = np.linalg.norm(corrected(signals, ellipse), axis=-1) * np.sqrt(ellipse[2] * ellipse[3])
        degrees = np.degrees(np.mod(phase, 2.0 * np.pi))
        traces = [
            Trace("raw", degrees, np.linalg.norm(signals, axis=1)),
            Trace("corrected", degrees, radius),
        ]
        plots.append(Plot(f"axis {axis}", "phase, deg", "radius, steps", traces))
    return plots


def _slit(found: dict[str, Any]) -> list[Plot]:
    um = 1e3 * found["deviation"]
    target = found["target"]
    cycles = um.shape[2]
    traces = []
    for way, name in enumerate(("forward, with its mean", "backward")):
        traces.append(Trace(name, np.repeat(target, cycles), um[:, way].ravel()))
    for way in (0, 1):
        traces.append(Trace("", target, um[:, way].mean(1), "line"))
    return [Plot("axis 11360/1", "target, mm", "deviation, um", traces)]
