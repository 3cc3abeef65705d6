"""Tables of docs/calibration.md: calibrations of the sample, and the gain by errors in variables.

    python -m docs.experiments.calibration

runs sample_data/telescope through the pipeline into a folder of its own, simulates calibrations by both estimators, and
renews the tables of the page.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from numpy.typing import NDArray

from docs.experiments.marked_tables import renew, table
from docs.experiments.sample_telescope import nominal
from docs.experiments.telescope_report_data import published
from truing.calibration.calibration_input import CalibrationData, MeasuredPlatform, PosesWithCovariance
from truing.calibration.estimation_problem import Case
from truing.calibration.fits import MachineCalibration, implicit, maximum_likelihood
from truing.calibration.model_cases import screened
from truing.estimation.rotation import exp_so3, log_so3
from truing.simulation.mechanisms.legs.closures import Legs
from truing.simulation.mechanisms.legs.kinematics import forward
from truing.simulation.mechanisms.structures.kinematic_model import KinematicModel
from truing.stages.common.calibration_data import body_poses

DOCS = Path(__file__).resolve().parents[1]
CAMPAIGN = DOCS.parent / "sample_data" / "telescope"
LIKELY, IMPLICIT = "errors-in-variables", "implicit"
ARCSEC = np.pi / 180 / 3600
DRAWS, FRESH, SEED = 40, 200, 20
TOLERANCE = {"a": 5e-4, "b": 5e-4, "u": 2e-3, "l": 5e-4}  # one sigma, m and 1
READING_M = 1e-6
RIGID = KinematicModel("6-pus")


@cache
def run_folder(stage: str = "calibrate") -> Path:
    """A folder with a fresh run of the sample campaign as far as a stage, for as long as this process lives."""
    run_sample(Path(_kept().name) / "run", stage)
    return Path(_kept().name) / "run"


def run_sample(folder: Path, stage: str) -> None:
    """Run the sample campaign into a folder as far as a stage."""
    from truing.pipeline.console import RunConsole
    from truing.pipeline.run_campaign import RunOptions, StageSelection, run_campaigns

    wish = RunOptions(StageSelection(None, stage, False), distrust=False, accept_failed_checks=True)
    if run_campaigns([CAMPAIGN], folder, wish, RunConsole(quiet=True)):
        raise RuntimeError("the sample campaign did not run")


@cache
def _kept() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory()


@cache
def artifact(name: str) -> pd.DataFrame:
    """A table of that run."""
    found: pd.DataFrame = pq.read_table(run_folder() / f"{name}.parquet").to_pandas()
    return found


def figures(estimator: str) -> pd.DataFrame:
    """Figures of all calibrations by an estimator, one row each."""
    rows = artifact("model_choice")
    wide = rows[rows["estimator"] == estimator].pivot(index=["model", "deformation"], columns="figure", values="value")
    order = [(m, d) for m in ("6-pus", "beam", "jacobian", "stiffness") for d in ("none", "linear", "matrix")]
    return wide.loc[[pair for pair in order if pair in wide.index]]


def table_of_models() -> str:
    """The twelve calibrations by maximum likelihood: pulls, held-out errors, evidence."""
    found = figures(LIKELY).assign(implicit_pull=figures(IMPLICIT)["rms_pull"])
    best = found["log_evidence"].max()
    rows = [
        [
            model,
            deformation,
            f"{row.rms_pull:.1f}",
            f"{row.implicit_pull:.1f}",
            f"{row.heldout_ratio:.1f}",
            f"{row.position_mean_verification:.0f}",
            f"{row.position_max_verification:.0f}",
            f"{row.position_noise_verification:.0f}",
            f"{row.orientation_mean_verification:.0f}",
            f"{round(row.log_evidence - best) + 0:d}",
            "chosen" if row.chosen else "indistinguishable" if row.indistinguishable else "",
        ]
        for (model, deformation), row in zip(found.index, found.itertuples(), strict=True)
    ]
    heads = [
        "model",
        "deformation",
        "rms pull",
        "rms pull, implicit",
        "held out / noise",
        "position µm, mean",
        "max",
        "noise",
        "orientation ″",
    ]
    return table([*heads, "log evidence", ""], rows)


def table_of_departures() -> str:
    """Differences of readings between the other models and rigid legs."""
    rows = artifact("model_choice").query("estimator == 'nominal'").set_index(["model", "figure"])["value"]
    names = {
        "jacobian": "linear about the reference pose (eq. 9)",
        "beam": "bending flexures",
        "stiffness": "elastic legs",
    }
    return table(
        ["model", "rms µm", "max µm"],
        [
            [
                f"`{model}`, {words}",
                *(f"{rows[model, f'reading_{which}_from_rigid_legs']:.1f}" for which in ("rms", "max")),
            ]
            for model, words in names.items()
        ],
    )


def table_of_kappa() -> str:
    """u_x where deformation is ignored, and what kappa makes it to be (eq. 40), leg by leg."""
    calibration = artifact("implicit_calibration").query("model == '6-pus'")
    u = calibration.query("deformation == 'none' and parameter == 'u_x'").set_index("leg")
    kappa = calibration.query("deformation == 'linear' and parameter == 'kappa'").set_index("leg")
    z = directions()
    rows = []
    for leg in u.index:
        slope = z[leg - 1, 0] / z[leg - 1, 2]
        k, x = kappa.loc[leg], u.loc[leg]
        expected = (-k.identified + x.identified**2 / 2) / slope
        reported = [
            f"{k.identified:+.4f} ± {k.sigma:.4f}",
            f"{slope:+.3f}",
            f"{expected:+.3f} ± {k.sigma / abs(slope):.3f}",
        ]
        rows.append([str(leg), *reported, f"{x.identified:+.3f} ± {x.sigma:.3f}"])
    return table(["leg", "κ (linear)", "z_x / z_z", "u_x from κ", "u_x (no deformation)"], rows)


def directions() -> NDArray:
    """Directions (6, 3) of the nominal legs at home."""
    from truing.simulation.mechanisms.legs.kinematics import reference_pose

    home: NDArray = reference_pose(nominal().legs).z[0]
    return home


@dataclass(frozen=True)
class Scenario:
    """Measurement of a simulated campaign: factor on the poses' noise, sigma of readings, poses that are off."""

    words: str
    noise: float = 1.0
    reading: float = READING_M
    bad: int = 0


SCENARIOS = (
    Scenario("as the sample: poses to 3 µm, readings to 1 µm"),
    Scenario("poses three times as noisy", noise=3.0),
    Scenario("readings to 5 µm", reading=5e-6),
    Scenario("two poses of forty off by 0.3 mm", bad=2),
)


def draw_machine(nominal: Legs, rng: np.random.Generator) -> Legs:
    """Legs as they may have been made, within the tolerances."""
    u = nominal.u + rng.normal(0.0, TOLERANCE["u"], (6, 3)) * [1.0, 1.0, 0.0]
    return nominal.replace(
        a=nominal.a + rng.normal(0.0, TOLERANCE["a"], (6, 3)),
        b=nominal.b + rng.normal(0.0, TOLERANCE["b"], (6, 3)),
        l=nominal.l + rng.normal(0.0, TOLERANCE["l"], 6),
        u=u / np.linalg.norm(u, axis=-1, keepdims=True),
    )


def measure(true: Legs, scenario: Scenario, rng: np.random.Generator) -> MeasuredPlatform:
    """Table 3 measured on such a machine, with the noise that the sample's poses have."""
    covariance = body_poses(pq.read_table(run_folder() / "poses.parquet"), "platform", tuple(range(1, 41))).covariance
    covariance = covariance * scenario.noise**2
    rho = true.rho0 + published().calibration
    found = forward(true, rho + rng.normal(0.0, scenario.reading, rho.shape))
    error = (np.linalg.cholesky(covariance) @ rng.normal(size=(40, 6, 1)))[..., 0]
    error[: scenario.bad, 0] += 3e-4
    poses = PosesWithCovariance(found.p + error[:, :3], exp_so3(error[:, 3:]) @ found.R, covariance)
    return MeasuredPlatform(tuple(range(1, 41)), np.full(40, "calibration", object), poses, poses, rho, {})


def both_errors(scenario: Scenario, rng: np.random.Generator) -> NDArray:
    """Of errors in variables and of the implicit fit (2, 3): rms position m and angle rad at fresh poses, a and b m."""

    machine = replace(nominal(), flexure_length=None)
    true = draw_machine(machine.legs, rng)
    measured = measure(true, scenario, rng)
    case = Case(RIGID, "none", machine)
    gathered = CalibrationData(measured, machine, TOLERANCE, scenario.reading, {}, None, "")
    kept = screened(gathered, measured, case).kept
    fresh = true.rho0 + rng.uniform(-1.3e-3, 1.3e-3, (FRESH, 6))
    everything = np.ones(40, bool)
    fits = (maximum_likelihood(gathered, measured, case, kept), implicit(gathered, measured, case, everything))
    return np.array([_errors(fit, true, fresh) for fit in fits])


def _errors(fit: MachineCalibration, true: Legs, fresh: NDArray) -> tuple[float, float, float]:
    there, said = forward(true, fresh), forward(fit.machine.legs, fresh)
    angle = log_so3(said.R @ np.swapaxes(there.R, -1, -2))
    joints = np.concatenate([fit.machine.legs.a - true.a, fit.machine.legs.b - true.b])
    rms = [float(np.sqrt(np.mean(np.sum(gap**2, -1)))) for gap in (said.p - there.p, angle)]
    return rms[0], rms[1], float(np.sqrt(np.mean(joints**2)))


def rms_errors(scenario: Scenario, draws: int = DRAWS) -> NDArray:
    """Root mean squares (2, 3) over draws of `both_errors`, in um, arc seconds and mm."""
    rng = np.random.default_rng(SEED)
    found = np.array([both_errors(scenario, rng) for _ in range(draws)])
    rms: NDArray = np.sqrt(np.mean(found**2, 0)) / [1e-6, ARCSEC, 1e-3]
    return rms


def table_of_estimators() -> str:
    """Errors of both estimators on simulated campaigns, with the same draws."""
    rows = []
    for scenario in SCENARIOS:
        rms = rms_errors(scenario)
        reported = [f"{rms[0, i]:.{d}f} against {rms[1, i]:.{d}f}" for i, d in ((0, 1), (1, 1), (2, 2))]
        rows.append([scenario.words, *reported])
    return table(["", "position at fresh poses, µm", "orientation, ″", "joints a, b, mm"], rows)


TABLES = {
    "models": table_of_models,
    "departures": table_of_departures,
    "kappa": table_of_kappa,
    "estimators": table_of_estimators,
}


def main() -> None:
    """Renew the tables."""
    renew(DOCS / "calibration.md", TABLES)


if __name__ == "__main__":
    main()
