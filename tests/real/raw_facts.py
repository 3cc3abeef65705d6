"""Figures of docs/real-data.md from outside the runs: reports, all readings, signals for plots."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.real import interferometer_logs, sensor_facts
from truing.estimation.interferometry.quadrature import fit_ellipse


def raw_facts(data: Path) -> dict[str, Any]:
    """Facts of the page from the folder of real measurements."""
    report = interferometer_logs.slit_report(data)["lines"]
    target, deviation = interferometer_logs.slit(data)
    own = deviation.mean(2)
    return {
        "stewart": sensor_facts.stewart(data),
        "quadrature": interferometer_logs.published_radius(data, "Heydemann"),
        "slit": {
            "report": report,
            "as_printed": float(own[:, 1].max() - own[:, 0].min()),
            "target": target,
            "deviation": deviation,
        },
        "strange": interferometer_logs.strange_axis(data),
    }


def drawn_signals(data: Path) -> dict[str, Any]:
    """Raw signals of the axes (3, N, 2), and their ellipses (3, 5)."""
    signals = interferometer_logs.quadrature(data)
    return {"signals": signals, "fit": fit_ellipse(signals).values}
