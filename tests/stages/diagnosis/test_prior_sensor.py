"""A sensor campaign that starts from an earlier one uses its results, finds nothing twice, and reports changes."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.blind.generator.sensor import campaign as generator
from tests.blind.generator.sensor.effects import Effect, LoadEccentricity
from tests.blind.generator.sensor.folder import write_campaign
from tests.blind.generator.sensor.layout import Layout, Programme, Tolerance
from tests.stages.line import run_line, settings_of
from tests.tolerance import assert_close
from truing.inference.fitted_model import FittedModel
from truing.inference.fitter import Fitter
from truing.inference.observations import Epochs, Frames, Observations
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults
from truing.simulation.bench.causes.load_path import LoadEccentricity as Eccentricity
from truing.simulation.bench.extended_model import ExtendedSensor, extended_sensor, read_sensor, write_sensor
from truing.simulation.bench.known_readings import zeros_of
from truing.stages.diagnosis.diagnosis_data import DiagnosisData
from truing.stages.diagnosis.prior_campaign import changes_table
from truing.stages.diagnosis.search import assembled_data

LAYOUT = Layout(
    "sensor",
    tolerance=Tolerance(stiffness=0.02),
    programme=Programme(axes=("fz", "mx"), levels=(0, 300, 600, 900, 600, 300, 0, -300, -600, -900, 0)),
)
OFFSET_M, ELSEWHERE_M = (3e-3, -2e-3, 0.0), (1e-3, -2e-3, 0.0)
FZ = Eccentricity("fz")


@dataclass(frozen=True)
class Machine:
    """Seeds of a campaign; the sensor has a seed of its own."""

    seed: int
    built: int = 11

    def spawn(self, count: int) -> list[np.random.Generator]:
        streams = zip(generator.STREAMS, range(count), strict=True)
        return [np.random.default_rng([self.built if name == "build" else self.seed, n]) for name, n in streams]


def measured(home: Path, seed: int, effects: Sequence[Effect], earlier: str | None = None) -> Path:
    """A campaign folder of the sensor, which starts from an earlier model where there is one."""
    made = generator.draw_campaign(LAYOUT, effects, Machine(seed))  # type: ignore[arg-type]
    folder = write_campaign(made, home / f"campaign-{seed}", seed)
    if earlier is not None:
        (home / f"model-{seed}.toml").write_text(earlier)
        toml = folder / "campaign.toml"
        text = toml.read_text().replace("[mechanism]\n", f'[mechanism]\nmodel = "../model-{seed}.toml"\n', 1)
        toml.write_text(text)
    return folder


def found_causes(tables: dict[str, Any]) -> list[tuple[str, str]]:
    rows = tables["diagnosis"].to_pylist()
    return [(row["cause"], row["subject"]) for row in rows if row["verdict"] == "found"]


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sensor")


@pytest.fixture(scope="module")
def first(home: Path) -> dict[str, Any]:
    """The first campaign, whose z load acts next to the origin."""
    return run_line(measured(home, 1, [LoadEccentricity(2, OFFSET_M)]), "ingest", "diagnose")[0]


@pytest.fixture(scope="module")
def second(home: Path, first: dict[str, Any]) -> dict[str, Any]:
    folder = measured(home, 2, [LoadEccentricity(2, OFFSET_M)], first["model"])
    return run_line(folder, "ingest", "diagnose")[0]


def test_persistent_causes_of_the_first_campaign_enter_the_second_and_are_not_found_again(
    first: dict[str, Any], second: dict[str, Any]
) -> None:
    assert found_causes(first) == [("load-eccentricity", "load fz")]
    assert found_causes(second) == []
    before, now = read_sensor(first["model"]), read_sensor(second["model"])
    assert [cause.key for cause in now.causes] == [cause.key for cause in before.causes] == [FZ.key]
    sigmas = [np.sqrt(np.diag(model.covariance)) for model in (before, now)]
    assert (sigmas[1][36:] < 0.85 * sigmas[0][36:]).all()
    assert_close(now.effects[0].values, np.array(OFFSET_M)[:2], atol=4 * sigmas[1][36:].max())
    assert not second["changes"].to_pandas()["changed"].any()
    assert not ARTIFACTS["changes"].faults(second["changes"])


def test_a_load_that_was_put_elsewhere_is_reported_as_a_change(home: Path, first: dict[str, Any]) -> None:
    folder = measured(home, 3, [LoadEccentricity(2, ELSEWHERE_M)], first["model"])
    started = assembled_data(run_line(folder, "ingest")[0], settings_of(folder))
    assert started.left_out.endswith("information of sensor on offset_x, which changed since")
    stand = Fitter(started.model, started.calibration, None, 0).prepared()
    table = changes_table(stand)
    assert table is not None
    changed = [row for row in table.to_pylist() if row["changed"]]
    assert [(row["effect_of"], row["parameter"]) for row in changed] == [("load-eccentricity load fz", "offset_x")]
    assert abs(changed[0]["change"] + 2.0) < 4 * changed[0]["sigma_change"]
    values, covariance = stand.values(FZ)
    assert_close(values, np.array(ELSEWHERE_M)[:2], atol=4 * np.sqrt(np.diag(covariance)).max())


def test_sequential_and_joint_evaluation_agree(home: Path, first: dict[str, Any]) -> None:
    gathered = [_gathered(home, seed, None) for seed in (4, 5)]
    alone, whole = _fitted(gathered[0]), _fitted(_together(*gathered))
    started = _gathered(home, 6, write_sensor(_extended(alone)), like=5)
    after = _extended(Fitter(started.model, started.calibration, None, 0).fitted(()))
    both = _extended(whole)
    sigma, sigma_after = (np.sqrt(np.diag(model.covariance)) for model in (both, after))
    assert_close(after.effects[0].values, both.effects[0].values, atol=0.01 * sigma[36:].min())
    assert_close((after.compliance - both.compliance).ravel() / sigma[:36], np.zeros(36), atol=0.01)
    assert_close(sigma_after / sigma, np.ones(len(sigma)), atol=0.01)


def _gathered(home: Path, seed: int, earlier: str | None, like: int | None = None) -> DiagnosisData:
    made = generator.draw_campaign(LAYOUT, [LoadEccentricity(2, OFFSET_M)], Machine(like or seed))  # type: ignore[arg-type]
    folder = write_campaign(made, home / f"alone-{seed}", seed)
    tables = run_line(folder, "ingest")[0]
    return assembled_data(tables if earlier is None else {**tables, "start": earlier}, settings_of(folder))


def _fitted(found: DiagnosisData) -> FittedModel:
    return Fitter(found.model, found.calibration, None, 0).fitted((FZ,))


def _extended(stand: FittedModel) -> ExtendedSensor:
    """The model of a fit with the noise as declared."""
    return extended_sensor(stand.model, stand.fit.shared, stand.fit.whitened.covariance(), {"campaign": "first"})


def _together(first: DiagnosisData, second: DiagnosisData) -> DiagnosisData:
    """Both campaigns as one, the runs of the second after those of the first."""
    one, two = (found.calibration for found in (first, second))
    later = replace(two.conditions, run=two.conditions.run + 1000, time_s=two.conditions.time_s + 1e6)
    arrays = {
        n: np.concatenate([getattr(one.conditions, n), getattr(later, n)]) for n in ("run", "step", "time_s", "load")
    }
    covariates = {n: np.concatenate([v, later.covariates[n]]) for n, v in one.conditions.covariates.items()}
    conditions = replace(one.conditions, covariates=covariates, **arrays)
    names = ("values", "covariance", "is_observed")
    points = Observations(*(np.concatenate([getattr(c.measured, n) for c in (one, two)]) for n in names))
    known = first.model.known
    model = replace(
        first.model,
        known=replace(known, zeros=zeros_of(conditions.run, points.is_observed, known.sigma)),
        conditions=conditions,
    )
    return replace(first, model=model, calibration=Epochs(points, conditions, Frames.of_numbers(len(conditions.load))))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("format = 2\n", "expected a model.toml that a run has written"),
        ('[model]\nmechanism = "6-pus"\n[[legs]]\n[covariance]\n', "expected a model of a 6-upur, not of a 6-pus"),
    ],
)
def test_a_file_that_is_no_model_of_a_sensor_is_a_fault(text: str, expected: str, tmp_path: Path) -> None:
    with pytest.raises(CampaignFaults, match=expected):
        run_line(measured(tmp_path, 7, [], text), "ingest")


def test_a_started_campaign_keeps_a_model_that_can_be_read(second: dict[str, Any]) -> None:
    assert tomllib.loads(second["start"])["model"]["mechanism"] == "6-upur"
