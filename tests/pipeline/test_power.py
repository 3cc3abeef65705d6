"""`truing power` of planned and measured campaigns, local or distributed: equal results, tables, and a page."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Targets
from tests.blind.generator.schedule import at_rest, random_moves
from tests.report.explained import unexplained, unlinked
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.command_line import app
from truing.pipeline.executor import LOCAL, Workforce, results
from truing.pipeline.power_command import PowerOptions, _plan, diagnosed_trial
from truing.pipeline.problems import Interrupted
from truing.schemas.campaign import Campaign
from truing.simulation.cause import Effect
from truing.simulation.detection_trials import Answer, Trial
from truing.simulation.mechanisms.causes.drive import ActuatorGain
from truing.stages.simulated_campaigns.plan import CampaignPlan

LAYOUT = Layout("small", targets=Targets(base=4, platform=4, per_leg=0))


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(3)
    campaign = draw_campaign(LAYOUT, [at_rest(), *random_moves(10, 2, rng)], [], rng)
    return write_campaign(campaign, tmp_path_factory.mktemp("power") / "campaign", 1)


@pytest.fixture
def planned(measured: Path, tmp_path: Path) -> Path:
    """The same campaign before anything was measured: no points."""
    folder = tmp_path / "planned"
    folder.mkdir()
    for name in ("campaign.toml", "targets.csv", "configurations.csv"):
        (folder / name).write_text((measured / name).read_text())
    return folder


def call(*words: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["power", *map(str, words)])
    return done.exit_code, done.output


def test_power_of_a_planned_campaign_reports_sizes_and_changes_no_file(planned: Path, tmp_path: Path) -> None:
    before = sorted(planned.iterdir())
    code, output = call(planned, "--draws", 0, "--out", tmp_path / "made" / "power.csv", "--json")
    assert code == 0, output
    assert sorted(planned.iterdir()) == before
    assert {path.name for path in (tmp_path / "made").iterdir()} == {"power.csv", "power-rates.csv", "power.html"}
    sizes = (tmp_path / "made" / "power.csv").read_text().splitlines()
    assert {line.split(",")[0].strip('"') for line in sizes[1:]} >= {"actuator-gain", "target-moved", "leg-thermal"}
    reported = json.loads(output)
    assert (reported["exit_code"], len(reported["sizes"])) == (0, len(sizes) - 1)
    assert {Path(row["file"]).name for row in reported["files"]} == {
        path.name for path in (tmp_path / "made").iterdir()
    }
    page = (tmp_path / "made" / "power.html").read_text()
    assert "By theory only" in page
    assert not unexplained(page)
    assert not unlinked(page, "cause")
    assert "http" not in page.split("<body>")[0].replace("http-equiv", "")


def reported_at_once(plan: CampaignPlan, settings: Campaign, trial: Trial) -> Answer:
    """Answer of an ideal diagnosis: it finds every effect from the expected size on, and errs once without an
    effect."""
    found = trial.factor >= 1.0 or (not trial.effects and trial.seed[-1] == 0)
    return Answer(trial.question, trial.factor, found, found, found, ())


def test_campaigns_are_counted_by_size(measured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("truing.pipeline.power_command.diagnosed_trial", reported_at_once)
    out = tmp_path / "power.parquet"
    code, output = call(measured, "--draws", 2, "--causes", "platform-deformation-matrix", "--out", out)
    assert code == 0, output
    (size,) = pq.read_table(out).to_pylist()
    assert size["cause"] == "platform-deformation-matrix"
    assert size["lower_80"] < size["expected_80"] < size["upper_80"]
    nothing, *rates = pq.read_table(tmp_path / "power-rates.parquet").to_pylist()
    assert (nothing["cause"], nothing["campaigns"], nothing["found"]) == ("nothing", 10, 0.1)
    assert [(row["campaigns"], row["named"]) for row in rates] == [(2, 0.0), (2, 0.0), (2, 1.0), (2, 1.0), (2, 1.0)]
    assert "1 of 10 campaigns" in output
    assert "platform deformation matrix" in (tmp_path / "power.html").read_text()


def test_an_interrupted_call_shows_what_it_has(measured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(plan: CampaignPlan, settings: Campaign, trial: Trial) -> Answer:
        if trial.seed[3] % 5 == 1 and trial.effects:
            raise Interrupted("SIGTERM")
        return reported_at_once(plan, settings, trial)

    monkeypatch.setattr("truing.pipeline.power_command.diagnosed_trial", interrupted)
    code, output = call(
        measured, "--draws", 2, "--causes", "platform-deformation-matrix", "--out", tmp_path / "power.parquet"
    )
    assert code == 4
    assert "interrupted (SIGTERM)" in output
    _, *rates = pq.read_table(tmp_path / "power-rates.parquet").to_pylist()
    assert [row["campaigns"] for row in rates] == [1] * 5


def test_theory_is_reported_first_and_each_round_narrows_the_sizes(
    measured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sizes by theory come before any simulated campaign; then each round replaces tables and page."""
    out, counted = tmp_path / "power.parquet", list[int]()

    def watched(plan: CampaignPlan, settings: Campaign, trial: Trial) -> Answer:
        rates = tmp_path / "power-rates.parquet"
        assert out.with_suffix(".html").exists(), "the first page, by theory alone"
        counted.append(sum(row["campaigns"] for row in pq.read_table(rates).to_pylist()) if rates.exists() else 0)
        return reported_at_once(plan, settings, trial)

    monkeypatch.setattr("truing.pipeline.power_command.diagnosed_trial", watched)
    code, output = call(measured, "--draws", 3, "--causes", "platform-deformation-matrix", "--out", out)
    assert code == 0, output
    assert counted == [0] * 10 + [10] * 10 + [20] * 10
    before, _, after = output.partition("By theory alone; 30 simulated campaigns follow.")
    assert "platform deformation matrix" in before
    assert f"first page: {out.with_suffix('.html')}" in after
    assert "after 1 of 3 draws" in after
    assert "after 3 of 3 draws" not in after


@pytest.fixture(scope="module")
def hidden(measured: Path) -> tuple[partial[Answer], Trial, Answer]:
    """The work of one campaign with an effect hidden in it, and what comes of it in this process."""
    campaign = open_campaign(measured)
    settings = campaign.validated()
    work = partial(diagnosed_trial, _plan(campaign, settings, PowerOptions()), settings)
    piece = Trial(0, 1.0, (Effect(ActuatorGain(), np.full(6, 0.02)),), (1,))
    return work, piece, work(piece)


def test_a_large_effect_that_is_hidden_is_found(hidden: tuple[partial[Answer], Trial, Answer]) -> None:
    assert hidden[2].found
    assert hidden[2].others_found


@pytest.mark.parametrize("workforce", [Workforce(2), Workforce(1, LOCAL)], ids=str)
def test_diagnosis_in_a_worker_process_gives_the_same_answer(
    hidden: tuple[partial[Answer], Trial, Answer], workforce: Workforce
) -> None:
    work, piece, here = hidden
    assert next(results(work, [piece], workforce, _refused)) == here


def _refused(piece: Any) -> Any:
    raise AssertionError("no worker is lost here")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--causes", "actuator-gain,actuator-gian"), "found 'actuator-gian'"),
        (("--out", "power.txt"), "a file that ends in .csv or .parquet"),
    ],
)
def test_unusable_options_of_power_are_refused(measured: Path, words: tuple[str, ...], expected: str) -> None:
    code, output = call(measured, *words)
    assert code == 2
    assert expected in output


def test_a_campaign_that_cannot_be_drawn_says_why(planned: Path) -> None:
    header, first, second, *_ = (planned / "configurations.csv").read_text().splitlines()
    (planned / "configurations.csv").write_text("\n".join([header, first, second]) + "\n")
    code, output = call(planned, "--draws", 0)
    assert code == 2
    assert "at least 3 poses" in output
    assert "found 2" in output


def test_a_campaign_of_bodies_without_a_mechanism_is_refused(tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text('[campaign]\nname = "mirror"\nkind = "photogrammetry"\n')
    (tmp_path / "points.csv").write_text("pose,body,target,x_mm,y_mm,z_mm\n1,mirror,M1,0,0,0\n")
    code, output = call(tmp_path)
    assert code == 2
    assert "mechanism.type" in output
    assert "found 'none'" in output
    assert "are not supported yet" in " ".join(output.split())


def test_points_without_a_survey_cannot_be_drawn_again(measured: Path, tmp_path: Path) -> None:
    for path in measured.iterdir():
        if path.name != "targets.csv":
            (tmp_path / path.name).write_bytes(path.read_bytes())
    code, output = call(tmp_path, "--draws", 0)
    reported, reason = output.splitlines()
    assert (code, reported) == (2, "targets.csv: expected the survey of the targets, or their planned places")
    assert reason.startswith("exit code 2:")
