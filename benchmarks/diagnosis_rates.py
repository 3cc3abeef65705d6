"""How often the diagnosis is right: false alarms, detection, naming and coverage over drawn campaigns.

    python -m benchmarks.diagnosis_rates [--campaigns 40] [--kinds nothing linear ...]

Campaigns come from the generator of the blind tests, which shares no code with truing, in four layouts in turn.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import ActuatorGain, Backlash, Effect, LinearDeformation, MatrixDeformation
from tests.blind.generator.folder import truth_path, write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Noise, Surroundings, Targets, telescope_geometry
from tests.blind.generator.schedule import at_rest, published_moves, random_moves
from tests.stages.line import run_line

LAYOUTS = (
    Layout(name="telescope"),
    Layout(
        name="noisy",
        noise=Noise(point_mm=0.012, actuator_mm=0.002),
        faults=DataFaults(missing_share=0.1, gross_share=0.02),
        surroundings=Surroundings(shuffled=True),
    ),
    Layout(
        name="other geometry",
        geometry=telescope_geometry(base_radius=260.0, platform_radius=200.0, length=420.0),
        targets=Targets(base=9, platform=7, per_leg=0, follow=0.3),
        noise=Noise(point_mm=0.008),
    ),
    Layout(
        name="noise 10 % above declared, heavy tails", noise=Noise(0.0055, declared_point_mm=0.005, heavy_tails=True)
    ),
)
LINEAR, MATRIX = "platform-deformation-linear", "platform-deformation-matrix"


def _of_size(shape: tuple[int, ...], size: float, rng: np.random.Generator) -> np.ndarray:
    pattern = rng.normal(size=shape)
    return pattern * size / np.sqrt(np.mean(pattern**2))


@dataclass(frozen=True)
class Kind:
    """What is hidden, the name it ought to get, and the layouts it is hidden in."""

    effects: Callable[[np.random.Generator], list[Effect]]
    name: str | None
    layouts: tuple[Layout, ...] = LAYOUTS


KINDS = {
    "nothing": Kind(lambda rng: [], None),
    "linear, kappa 0.01": Kind(lambda rng: [LinearDeformation(_of_size((6,), 0.01, rng))], LINEAR),
    "matrix, K 0.012": Kind(lambda rng: [MatrixDeformation(_of_size((6, 6), 0.012, rng))], MATRIX),
    "linear, kappa 0.0007": Kind(lambda rng: [LinearDeformation(_of_size((6,), 0.0007, rng))], LINEAR, LAYOUTS[:1]),
    "gain 0.002": Kind(lambda rng: [ActuatorGain(_of_size((6,), 0.002, rng))], "unexplained", LAYOUTS[:1]),
    "backlash 4 um": Kind(lambda rng: [Backlash(_of_size((6,), 0.004, rng))], "unexplained", LAYOUTS[:1]),
}


@dataclass(frozen=True)
class Result:
    """One campaign: what was found, the pulls of the parameters, and the seconds that the diagnosis took."""

    found: list[str]
    pulls: np.ndarray
    seconds: float


def main() -> None:
    """Draw, diagnose and print one line per kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaigns", type=int, default=40, help="per kind; three times as many with nothing hidden")
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name in options.kinds:
        count = options.campaigns * (3 if name == "nothing" else 1)
        print(_line(name, [_run(name, number, options.seed) for number in range(count)]), flush=True)


def _run(name: str, number: int, seed: int) -> Result:
    kind = KINDS[name]
    rng = np.random.default_rng([seed, list(KINDS).index(name), number])
    layout = kind.layouts[number % len(kind.layouts)]
    moves = random_moves(36, 8, rng) if layout.targets.follow or layout.surroundings.shuffled else published_moves()
    campaign = draw_campaign(layout, [at_rest(), *moves], kind.effects(rng), rng)
    with tempfile.TemporaryDirectory() as home:
        folder = write_campaign(campaign, Path(home) / "campaign", number)
        start = time.perf_counter()
        tables, _ = run_line(folder, "ingest", "pose", "diagnose")
        seconds = time.perf_counter() - start
        truth = json.loads(truth_path(folder).read_text(encoding="utf-8"))
    found = [row for row in tables["diagnosis"].to_pylist() if row["verdict"] == "found"]
    return Result([row["cause"] for row in found], _pulls(found, truth), seconds)


def _pulls(found: list[dict[str, Any]], truth: dict[str, Any]) -> np.ndarray:
    pulls = []
    for effect in truth["effects"]:
        for row in (row for row in found if row["cause"] == effect["cause"]):
            told = json.loads(row["parameters"])
            pulls += [(told[k]["value"] - v["value"]) / told[k]["sigma"] for k, v in effect["parameters"].items()]
    return np.array(pulls)


def _line(name: str, results: list[Result]) -> str:
    wanted = KINDS[name].name
    named = sum(wanted in result.found for result in results)
    other = sum(any(cause != wanted for cause in result.found) for result in results)
    pulls = np.concatenate([result.pulls for result in results])
    said = f"{name:22} {len(results):4} campaigns, named {named:3}, something else found {other:2}"
    if len(pulls):
        within = float(np.mean(np.abs(pulls) < 2))
        said += f", pulls rms {np.sqrt(np.mean(pulls**2)):.2f}, within two sigma {within:.1%} of {len(pulls)}"
    return f"{said}, median {np.median([result.seconds for result in results]):.1f} s"


if __name__ == "__main__":
    main()
