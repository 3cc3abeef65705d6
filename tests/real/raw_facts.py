"""Figures of docs/real-data.md on files that are no campaign: raw signals of interferometers, reports, all readings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.real import interferometer_logs, sensor_facts


def raw_facts(data: Path) -> dict[str, Any]:
    """What the page says of them, from the folder of real measurements."""
    signals = interferometer_logs.quadrature(data)
    axes = interferometer_logs.quadrature_facts(signals)
    slit = interferometer_logs.slit_facts(data)
    target, deviation = interferometer_logs.slit(data)
    return {
        "stewart": sensor_facts.stewart(data),
        "quadrature": {
            "samples": signals.shape[1],
            "raw": axes.raw,
            "corrected": axes.corrected,
            "published": interferometer_logs.published_radius(data, "Heydemann"),
            "unclipped": axes.unclipped,
            "clipped": 100.0 * axes.clipped_share,
            "periodic_nm": axes.periodic_nm,
            "flagged": ["yes" if bad else "no" for bad in axes.flagged],
            "signals": signals,
            "fit": axes.fit.values,
        },
        "slit": {
            "ours": slit["ours"],
            "report": {name: slit["report"][name] for name in slit["ours"]},
            "wrong": slit["wrong"],
            "as_printed": slit["as_printed"],
            "sigma_a": slit["uncertainty"]["A"].sigma,
            "target": target,
            "deviation": deviation,
        },
        "strange": interferometer_logs.strange_axis(data),
    }
