"""Every figure of docs/cable-robot.md, from the logs of the cable robot: ``python -m tests.real.cable_facts``."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from numpy.typing import NDArray

from tests.real.cable_robot import (
    ANGLE_RAD,
    CABLES,
    DRIVES,
    LENGTH_M,
    RUNS,
    SWIVEL_RAD,
    CableProblem,
    Run,
    filled,
    fit,
    geometry,
    load,
    rotation,
    swivelled,
)
from tests.real.campaigns import data_folder
from tests.real.pulley_cable import PulleyCable
from truing.estimation.design.observability import Observability, choose_identifiable, inseparable, observe
from truing.simulation.mechanisms.legs.kinematics import upper_joints

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "cable-robot.md"
FOLDER = "cdpr-irma4"
HOPELESS = 20.0  # tolerances
YAW = 8
# What is supposed to be known beforehand, one sigma: the data come without tolerances.
SUPPOSED = {"ratio": 0.1, "swivel": np.radians(1.0), "yaw": np.radians(10.0), "l": 0.1, "a": 0.01, "b": 0.01}


def facts(folder: Path) -> dict[str, Any]:
    """Closure, drives, what can be known, and what holds on the run that a fit has not seen."""
    runs = {poses: load(folder / FOLDER, poses) for poses in RUNS}
    found: dict[str, Any] = {f"closure{poses}": closure(run) for poses, run in runs.items()}
    fits = {poses: drives(run) for poses, run in runs.items()}
    for poses, run in runs.items():
        seen, chosen = knowledge(run, fits[poses])
        other = next(n for n in RUNS if n != poses)
        found[f"drives{poses}"] = fits[poses]
        found[f"known{poses}"] = reported(seen, chosen)
        found[f"joints{poses}"] = joints(run, fits[poses], chosen)
        values = {"zeros": zeros(run), "drives": fits[poses]["values"], "joints": found[f"joints{poses}"]["values"]}
        found[f"heldout{other}"] = heldout(runs[other], values)
    return found | extremes(found)


def extremes(found: dict[str, Any]) -> dict[str, float]:
    """Smallest deviation of ratios from 1 and largest from the authors' values, in sigmas; largest motion of a joint,
    mm."""
    fits = [found[f"drives{poses}"] for poses in RUNS]
    moved = [abs(value) for poses in RUNS for value in found[f"joints{poses}"]["moved_mm"].values()]
    return {
        "least_sigmas": min(np.min(np.abs(f["ratio"] - 1.0) / f["sigma"]) for f in fits),
        "most_off": max(np.max(np.abs(f["ratio"] - f["authors"]) / f["sigma"]) for f in fits),
        "most_moved": max(moved),
    }


def closure(run: Run) -> dict[str, float]:
    """Closure of the authors' poses over measured changes of length and angle; lengths with and without pulleys."""
    p, R = run.solved[:, :3], rotation(run.solved[:, 3:])
    straight = run.legs.replace(closure=PulleyCable(0.0))
    turned = swivelled(run.legs, run.frames, upper_joints(run.legs, p, R))[0]
    return {
        "pulley_mm": 1e3 * _rms(_changes(_lengths(run.legs, p, R) - run.lengths)),
        "point_mm": 1e3 * _rms(_changes(_lengths(straight, p, R) - run.lengths)),
        "uncorrected_mm": 1e3 * _rms(_changes(_lengths(run.legs, p, R) - run.raw)),
        "swivel_deg": np.degrees(_rms(_changes(turned - run.swivel))),
        "travel_m": float(np.ptp(run.lengths, axis=0).max()),
        "authors_mm": 1e3 * run.position_error,
        "authors_again_mm": 1e3 * float(np.linalg.norm(run.solved[0, :3] - run.first[:3])),
    }


def _lengths(legs: Any, p: NDArray, R: NDArray) -> NDArray:
    return legs.closure.invert(legs, upper_joints(legs, p, R) - legs.a)


def _changes(values: NDArray) -> NDArray:
    """Values (B - 1, 4) counted from those of the first pose."""
    return values[1:] - values[:1]


def _rms(values: NDArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def zeros(run: Run) -> NDArray:
    """Values with the authors' ratios, and zeros and lengths at homing of the run."""
    problem = CableProblem(run, run.raw, geometry())
    place = np.arange(len(problem.labels))
    start = filled(problem.start, place < CABLES, run.gains)
    free = (place >= CABLES) & (place < DRIVES)
    return filled(start, free, fit(problem, free, start).values)


def drives(run: Run) -> dict[str, Any]:
    """Ratios, zeros and lengths at homing from the log as it is, joints as drawn, nothing else known."""
    problem = CableProblem(run, run.raw, geometry())
    free = np.arange(len(problem.labels)) < DRIVES
    found = fit(problem, free, problem.start)
    sigma = np.sqrt(np.diag(found.covariance_at(found.noise_ratio)))
    hung = run.planned[:, :3] + found.deviations[:, :3]
    return {
        "status": str(found.status),
        "values": filled(problem.start, free, found.values),
        "noise_ratio": found.noise_ratio,
        "ratio": found.values[:CABLES],
        "sigma": sigma[:CABLES],
        "authors": run.gains,
        "homing_mm": 1e3 * found.values[9:13],
        "homing_sigma_mm": 1e3 * sigma[9:13],
        "noise": [found.noise_ratio * s for s in (1e3 * LENGTH_M, *np.degrees([SWIVEL_RAD, ANGLE_RAD]))],
        "off_authors_mm": 1e3 * float(np.sqrt(np.mean(np.sum((hung - run.solved[:, :3]) ** 2, axis=1)))),
        "first_off_authors_mm": 1e3 * float(np.linalg.norm(hung[0] - run.solved[0, :3])),
        "first_off_inclinometer_mm": 1e3 * float(np.linalg.norm(hung[0] - run.first[:3])),
    }


def supposed(problem: CableProblem) -> NDArray:
    """Scales (P,), SI."""
    return np.array([SUPPOSED[label.rstrip("1234").partition("_")[0]] for label in problem.labels])


def knowledge(run: Run, of: dict[str, Any]) -> tuple[Observability, Observability]:
    """Observability of all values at the found noise, and of the set to identify, drives first."""
    problem = CableProblem(run, run.raw, geometry())
    scale, units = supposed(problem), problem.units
    at = fit(problem, np.ones(len(scale), bool), of["values"], scale)
    J = at.jacobian.reshape(-1, len(scale)) / of["noise_ratio"] * units
    late = np.arange(len(scale)) >= DRIVES
    whole = observe(J, scale / units, problem.labels)
    return whole, choose_identifiable(J, scale / units, problem.labels, preference=late).observability


def reported(seen: Observability, chosen: Observability) -> dict[str, Any]:
    """Rank, the set, and what is hopeless, by name."""
    hopeless = replace(seen, least=1.0 / HOPELESS)
    groups = [pair for group in inseparable(hopeless) for pair in zip(group.texts, group.sigma, strict=True)]
    return {
        "parameters": len(seen.labels),
        "rank": seen.rank,
        "hopeless": [(text.removesuffix(" is unobservable"), sigma) for text, sigma in groups],
        "chosen": chosen.labels,
    }


def joints(run: Run, of: dict[str, Any], chosen: Observability) -> dict[str, Any]:
    """The fit of the chosen set about the drawing."""
    problem = CableProblem(run, run.raw, geometry())
    free = np.isin(problem.labels, chosen.labels)
    # the prior is counted in the declared noise, of which only this share was found
    found = fit(problem, free, of["values"], supposed(problem) / of["noise_ratio"])
    values = filled(of["values"], free, found.values)
    moved = {
        label: 1e3 * (value - nominal)
        for label, value, nominal in zip(problem.labels, values, problem.nominal, strict=True)
        if label in chosen.labels and label[0] in "ab"
    }
    return {"status": str(found.status), "values": values, "noise_ratio": found.noise_ratio, "moved_mm": moved}


def heldout(run: Run, values: dict[str, NDArray]) -> dict[str, float]:
    """Noise over the declared one, only poses and the yaw's zero of a run being fitted, by where values are from."""
    corrected, logged = (CableProblem(run, length, geometry()) for length in (run.lengths, run.raw))
    free = np.arange(len(corrected.labels)) == YAW
    found = {name: fit(logged, free, value).noise_ratio for name, value in values.items()}
    return {"corrected": fit(corrected, free, corrected.nominal).noise_ratio, **found}


def render(found: dict[str, Any]) -> str:
    """The page."""
    environment = jinja2.Environment(trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string((HERE / "cable-robot.md.jinja").read_text(encoding="utf-8"))
    return template.render(found, runs=RUNS).rstrip() + "\n"


def main() -> int:
    """Write the page."""
    if not (data_folder() / FOLDER).is_dir():
        sys.stderr.write(f"no {FOLDER} in {data_folder()}; TRUING_REAL_DATA names the folder of real measurements\n")
        return 4
    PAGE.write_text(render(facts(data_folder())), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
