"""The cause of docs/own-cause.md, installed as the page says, is found, named, stored and used for predictions."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.effects import Effect, Setting
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import DataFaults, Layout, Surroundings, Targets
from tests.blind.generator.machine import Machine
from tests.blind.generator.named_effect import Parameter
from tests.blind.generator.schedule import random_moves
from tests.conftest import PROJECT
from tests.docs.shown import shown
from tests.simulation.mechanisms.telescope import readings, telescope
from tests.stages.line import run_line
from tests.tolerance import assert_between
from truing.schemas.faults import CampaignFaults
from truing.simulation.mechanisms.state import State
from truing.stages.predict import predict

PAGE = (PROJECT / "docs" / "own-cause.md").read_text(encoding="utf-8")
CODE, CHECK = re.findall(r"```python\n(.*?)```", PAGE, re.S)
(PACKAGE,) = re.findall(r"```toml\n(.*?)```", PAGE, re.S)
SWELLING = 8e-6
LINE = ("ingest", "qa", "pose", "diagnose")


@dataclass(frozen=True)
class Swelling(Effect):
    """Legs are longer by a share for every per cent of humidity above 50."""

    share: float
    id = "leg-swelling"

    def parameters(self) -> Mapping[str, Parameter]:
        return {"swelling": (self.share, "1/%")}

    def structure(self, machine: Machine, setting: Setting) -> None:
        damp = setting.schedule.further["humidity_pct"] - 50.0
        machine.length *= 1 + self.share * damp[:, None]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the effect is hidden."""
    rng = np.random.default_rng(17)
    layout = Layout(
        "damp",
        targets=Targets(base=8, platform=7, per_leg=0),
        faults=DataFaults(0.02, 0.005),
        surroundings=Surroundings(columns=("humidity_pct",)),
    )
    drawn = draw_campaign(layout, random_moves(22, 6, rng), [Swelling(SWELLING)], rng)
    return write_campaign(drawn, tmp_path_factory.mktemp("damp") / "damp", 17)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The package of the page, built and put next to truing by pip, and gone again afterwards."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("site")
    (source / "leg_swelling.py").write_text(CODE, encoding="utf-8")
    (source / "pyproject.toml").write_text(PACKAGE, encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-build-isolation", "--quiet", "--target"]
    subprocess.run([*pip, str(target), str(source)], check=True)
    sys.path.insert(0, str(target))
    importlib.invalidate_caches()
    yield str(target)
    sys.path.remove(str(target))
    sys.modules.pop("leg_swelling", None)
    importlib.invalidate_caches()


@pytest.fixture(scope="module")
def diagnosed(campaign: Path, installed: Any) -> dict[str, Any]:
    return run_line(campaign, *LINE)[0]


def _found_rows(tables: dict[str, Any]) -> list[dict[str, Any]]:
    return [row for row in tables["diagnosis"].to_pylist() if row["verdict"] == "found"]


@pytest.mark.usefixtures("installed")
def test_the_example_passes_the_derivative_check_of_the_page() -> None:
    from leg_swelling import LegSwelling

    rho = readings(np.random.default_rng(3), 4)
    state = State(telescope(), rho, np.zeros_like(rho), covariates={"humidity_pct": np.array([30.0, 45.0, 60.0, 75.0])})
    exec(CHECK, {"np": np, "cause": LegSwelling(), "state": state, "values": np.array([1e-6]), "j": 0})


def test_the_hidden_effect_is_found_and_named_with_its_size(diagnosed: dict[str, Any]) -> None:
    rows = _found_rows(diagnosed)
    assert [row["cause"] for row in rows] == ["leg-swelling"]
    reported = json.loads(rows[0]["parameters"])["swelling"]
    assert reported["unit"] == "1/%"
    assert_between((reported["value"] - SWELLING) / reported["sigma"], -3.9, 3.9, what="pull of the swelling")
    assert rows[0]["clause"] == "the legs swell with the humidity of the air"
    assert rows[0]["advice_kind"] == "confirm" or rows[0]["next_in_short"]
    assert rows[0]["rms_after"] < rows[0]["rms_before"]


def test_the_page_shows_what_is_found(diagnosed: dict[str, Any]) -> None:
    """To a unit of the last digit shown, and of the next to last where the search's draws come in."""
    row, page = _found_rows(diagnosed)[0], shown(PAGE, "found")
    reported = json.loads(row["parameters"])["swelling"]
    value, sigma = re.search(r"swelling = \((\d\.\d) ± (\d\.\d)\)e-06 1/%", page).groups()
    assert float(value) == pytest.approx(reported["value"] * 1e6, abs=0.06)
    assert float(sigma) == pytest.approx(reported["sigma"] * 1e6, abs=0.06)
    assert float(re.search(r"`signal_to_noise` \| ([\d.]+)", page)[1]) == pytest.approx(row["signal_to_noise"], abs=0.3)
    shown_um = re.search(r"noise_floor` \| ([\d.]+), ([\d.]+) and ([\d.]+) µm", page).groups()
    for text, name in zip(shown_um, ("rms_before", "rms_after", "noise_floor"), strict=True):
        assert float(text) == pytest.approx(row[name], abs=0.02)


def test_the_effect_of_humidity_is_in_the_model_and_its_predictions(diagnosed: dict[str, Any]) -> None:
    (effect,) = tomllib.loads(diagnosed["model"])["effects"]
    assert effect["cause"] == "leg-swelling"
    damp = diagnosed["configurations"]
    poses = predict(diagnosed["model"], damp)
    column = damp.schema.get_field_index("humidity_pct")
    damper = damp.set_column(column, "humidity_pct", [np.asarray(damp["humidity_pct"]) + 10.0])
    lifted = np.asarray(predict(diagnosed["model"], damper)["pz_mm"]) - np.asarray(poses["pz_mm"])
    longer = json.loads(_found_rows(diagnosed)[0]["parameters"])["swelling"]["value"] * 10.0 * 500.0
    # Legs that lean lift the platform by more than they grow, by one over the cosine.
    assert_between(float(lifted.mean()) / longer, 1.0, 1.3, what="rise of the platform over growth of a leg")
    with pytest.raises(CampaignFaults, match="humidity_pct"):
        predict(diagnosed["model"], damp.drop_columns(["humidity_pct"]), "inputs.csv")


def test_without_its_package_an_effect_is_reported_by_its_inputs_only(
    campaign: Path, installed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [place for place in sys.path if place != installed])
    monkeypatch.delitem(sys.modules, "leg_swelling", raising=False)
    importlib.invalidate_caches()
    rows = _found_rows(run_line(campaign, *LINE)[0])
    assert [row["cause"] for row in rows] == ["unexplained"]
    assert rows[0]["follows"] == "humidity_pct"
