"""Tables of docs/interferometer.md: signals, fringes, compliance, positioning of an axis.

    TRUING_REAL_DATA=FOLDER python -m docs.experiments.interferometer

renews the tables of docs/interferometer.md; FOLDER/sios-nmm-quadrature and FOLDER/ess-slit-iso230 are public
measurements (not ours to copy), without which their two tables stay as they are. The same numbers on every run.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from docs.experiments.interferometer_bench import (
    compliance_table,
    entries_table,
    signed,
)
from docs.experiments.marked_tables import renew, table
from tests.real.interferometer_logs import AXES, quadrature, quadrature_facts, slit_facts
from tests.simulation.test_air import NIST
from truing.estimation.interferometry.quadrature import corrected_phase, count_fringes, fit_ellipse, misstep_probability
from truing.simulation.air import ciddor_index, edlen_index, edlen_slopes, vapour_pressure_pa

PAGE = Path(__file__).resolve().parents[1] / "interferometer.md"
SHOWN = (0, 1, 3, 6, 8)  # of the published values
ELLIPSE = np.array([30.0, -12.0, 500.0, 430.0, 0.12])
CHANNELS, SAMPLES, SIGNAL_NOISE = 40, 300, 2.5
ROUND = np.linspace(0.0, 2.0 * np.pi, 96, endpoint=False)


def air_table() -> str:
    """Published indices of air, and how far ours are from them."""
    rows = []
    for t, humidity, kpa, nm, ciddor, edlen in NIST[list(SHOWN)]:
        at = 1e-9 * nm, t, 1e3 * kpa, vapour_pressure_pa(t, 0.01 * humidity)
        off = 1e9 * (ciddor_index(*at) - ciddor), 1e9 * (edlen_index(*at) - edlen)
        cells = [f"{t:.0f}", f"{kpa:g}", f"{humidity:.0f}"]
        rows.append([*cells, f"{ciddor:.9f}", signed(off[0], 1), f"{edlen:.9f}", signed(off[1], 1)])
    return table(["°C", "kPa", "% humidity", "Ciddor", "ours, 1e-9", "Edlén", "ours, 1e-9"], rows)


def worth_table() -> str:
    """Error by air of an uncompensated reading that counts up as its path gets longer."""
    vapour = float(vapour_pressure_pa(20.0, 0.5))
    by_kelvin, by_pascal, by_vapour = edlen_slopes(632.99e-9, 20.0, 101325.0, vapour)
    changes = {
        "1 K of air": by_kelvin,
        "1 hPa of pressure": 100.0 * by_pascal,
        "10 % of humidity": by_vapour * 0.1 * float(vapour_pressure_pa(20.0, 1.0)),
    }
    rows = [[name, signed(1e6 * n, 2), signed(1e6 * n, 2), signed(1e6 * n * 2e-3, 4)] for name, n in changes.items()]
    return table(["change", "n, 1e-6", "um per m of dead path", "um in 2 mm of displacement"], rows)


def signals_table(folder: Path) -> str:
    """The laboratory's quadrature signals before and after the correction."""
    facts = quadrature_facts(quadrature(folder))
    rows = [
        [
            axis,
            f"{facts.raw[k]:.2f}",
            f"{facts.corrected[k]:.2f}",
            f"{100 * facts.corrected[k] / facts.mean_radius[k]:.2f} %",
            "yes" if facts.flagged[k] else "no",
            f"{100 * facts.clipped_share[k]:.0f} %",
            f"{facts.unclipped[k]:.2f}",
            f"{facts.periodic_nm[k]:.2f}",
        ]
        for k, axis in enumerate(AXES)
    ]
    heads = [
        "axis",
        "radius, raw",
        "corrected",
        "of the radius",
        "flagged",
        "cut off",
        "corrected without those",
        "error nm",
    ]
    return table(heads, rows)


def arcs_table() -> str:
    """Accuracy of the correction by the arc of the ellipse that the signals trace."""
    rows = []
    for degrees in (360.0, 180.0, 150.0, 120.0, 105.0, 90.0, 60.0):
        rng = np.random.default_rng(round(degrees))
        start = rng.uniform(0.0, 2.0 * np.pi, (CHANNELS, 1))
        seen = signals_at(start + rng.uniform(0.0, np.radians(degrees), (CHANNELS, SAMPLES)))
        fit = fit_ellipse(seen + SIGNAL_NOISE * rng.standard_normal(seen.shape))
        found = corrected_phase(np.broadcast_to(signals_at(ROUND), (CHANNELS, len(ROUND), 2)), fit.values)
        worst = np.abs(np.angle(np.exp(1j * (found - ROUND)))).max(1)
        given = f"{CHANNELS * fit.ok.mean():.0f} of {CHANNELS}"
        reported = [
            f"{1e3 * np.median(value[fit.ok]):.1f}" if fit.ok.any() else "–" for value in (fit.phase_sigma, worst)
        ]
        rows.append([f"{degrees:.0f}", given, *reported])
    return table(["arc, degrees", "correction given", "stated, mrad (1 sigma)", "largest error, mrad"], rows)


def signals_at(phase: np.ndarray) -> np.ndarray:
    """Signals (..., 2) of a true ellipse."""
    x0, y0, a, b, lag = ELLIPSE
    return np.stack([x0 + a * np.cos(phase), y0 + b * np.sin(phase + lag)], -1)


def counting_table() -> str:
    """Rate of steps between samples that are counted a turn wrong, and of those called doubtful."""
    rows, steps = [], 100000
    for turns, sigma in ((0.2, 0.3), (0.35, 0.3), (0.4, 0.3), (0.45, 0.1), (0.45, 0.02)):
        rng = np.random.default_rng(round(1000 * turns))
        true = np.stack([np.zeros(steps), np.full(steps, 2.0 * np.pi * turns)], -1)
        seen = true + sigma * rng.standard_normal(true.shape)
        found = count_fringes(np.angle(np.exp(1j * seen)), sigma)
        wrong = np.abs(np.diff(found.phase) - np.diff(seen))[:, 0] > np.pi
        doubted = f"{100 * found.doubtful[wrong, 1].mean():.0f} %" if wrong.any() else "–"
        expected = 100 * float(misstep_probability(2.0 * np.pi * turns, sigma))
        rows.append([f"{turns:g}", f"{1e3 * sigma:.0f}", f"{expected:.3f} %", f"{100 * wrong.mean():.3f} %", doubted])
    return table(
        ["turns per sample", "noise, mrad", "wrong, by formula", "wrong, counted", "of these called doubtful"], rows
    )


def positioning_table(folder: Path) -> str:
    """The laboratory's report line by line, um."""
    found = slit_facts(folder)
    rows = []
    for name, printed in found["report"].items():
        sure = found["uncertainty"].get(name)
        reported = [f"{1e3 * sure.sigma:.1f}", f"{1e3 * sure.low:.1f} to {1e3 * sure.high:.1f}"] if sure else ["", ""]
        verdict = "differs" if name in found["wrong"] else "equal"
        rows.append([name, f"{1e3 * printed:.2f}", f"{1e3 * found['ours'][name]:.2f}", verdict, *reported])
    return table(["line", "printed", "ours", "", "sigma", "95 %"], rows)


MADE: dict[str, Callable[[], str]] = {
    "air": air_table,
    "worth": worth_table,
    "arcs": arcs_table,
    "counting": counting_table,
    "compliance": compliance_table,
    "entries": entries_table,
}
MEASURED: dict[str, Callable[[Path], str]] = {"signals": signals_table, "positioning": positioning_table}


def main() -> None:
    """Renew the tables."""
    tables = dict(MADE)
    if folder := os.environ.get("TRUING_REAL_DATA"):
        tables |= {name: lambda make=make: make(Path(folder)) for name, make in MEASURED.items()}  # type: ignore[misc]
    renew(PAGE, tables)


if __name__ == "__main__":
    main()
