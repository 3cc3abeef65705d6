"""All calibrations of a campaign of 47 poses: python -m benchmarks.calibration [--repeats 9].

Seconds for the sample campaign on one pinned processor, as the command line runs it: the twelve calibrations with
covariances, by either estimator, then with all that the stage finds out besides (errors of every pose, model choice,
identifiability, absorption). A row prints no figure where one of the calibrations has not converged.
"""

from __future__ import annotations

import argparse
import tempfile
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.rows import Row, record_row
from benchmarks.timing import interleaved, pin, run_pinned
from tests.cut_telescope import cut_telescope
from truing.calibration.calibration_input import CalibrationData
from truing.calibration.estimation_problem import cases
from truing.calibration.fits import MachineCalibration, implicit, maximum_likelihood
from truing.calibration.model_cases import screened
from truing.pipeline.in_memory import stage_line
from truing.schemas.campaign import Campaign, read_campaign
from truing.simulation.mechanisms.structures.catalogue import structures
from truing.stages import calibrate as stage
from truing.stages.common.calibration_data import assemble

SMALLEST = ("--repeats", "1", "--threads", "1", "--cut")
CAMPAIGN = Path(__file__).resolve().parents[1] / "sample_data" / "telescope"


def tables(place: Path) -> tuple[dict[str, object], Campaign]:
    """Return the input tables of the stage, from the stages before it, and the settings."""
    campaign = read_campaign(tomllib.loads((place / "campaign.toml").read_text(encoding="utf-8")))
    line = stage_line(place).call("ingest", "qa", "pose", "deformation", "diagnose")
    names = [name.rstrip("?") for name in stage.DECLARATION.reads]
    return {name: line.tables[name] for name in names if name in line.tables}, campaign


def calibrations(gathered: CalibrationData, how: Callable[..., MachineCalibration]) -> list[MachineCalibration]:
    """Return the twelve calibrations, bad poses looked for first."""
    used = gathered.measured.subset(gathered.measured.roles != "verification")
    every = list(cases(gathered, structures(gathered.machine)))
    clean = screened(gathered, used, every[2])
    return [how(gathered, clean.measured, case, clean.kept) for case in every]


def measure(place: Path, repeats: int) -> None:
    """Print seconds per row: minimum, median, maximum."""
    given, campaign = tables(place)
    gathered = assemble(given, campaign)
    found: dict[str, list[MachineCalibration]] = {}

    def twelve(name: str, how: Callable[..., MachineCalibration]) -> None:
        found[name] = calibrations(gathered, how)

    hows = {"12 by errors in variables": maximum_likelihood, "12 by the closure alone": implicit}
    rows: dict[str, Callable[[], object]] = {
        **{name: partial(twelve, name, how) for name, how in hows.items()},
        "the whole stage, 24 of them": lambda: stage.run(given, campaign, lambda *_: None),
    }
    for name, seconds in interleaved(rows, repeats).items():
        bad = [one.status for one in found.get(name, ()) if one.status != "ok"]
        if bad:
            print(f"{name}: not converged: {bad[0]}")
            continue
        record_row(Row(f"calibrations of {place.name}: {name}", 1e3 * float(np.median(seconds)), "ms"))
        print(f"{name:30} {np.min(seconds):7.3f} {np.median(seconds):7.3f} {np.max(seconds):7.3f} s", flush=True)


def main() -> None:
    """Measure in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--cut", action="store_true", help="nine poses alone")
    chosen = parser.parse_args()
    if chosen.threads is None:
        further = ["--cut"] if chosen.cut else []
        run_pinned("benchmarks.calibration", ["--repeats", str(chosen.repeats), *further], 1)
        return
    pin(chosen.threads)
    with tempfile.TemporaryDirectory() as folder:
        measure(cut_telescope(Path(folder) / "cut") if chosen.cut else CAMPAIGN, chosen.repeats)


if __name__ == "__main__":
    main()
