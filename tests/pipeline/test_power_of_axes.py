"""`truing power` for a single axis: laws of the detectable size, agreement with an independent generator, bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from click.testing import Result
from scipy.stats import fisher_exact
from typer.testing import CliRunner

from tests.blind.generator.axis import AxisLayout, Hidden, record, write
from tests.ignored_causes import search_only
from tests.sentences import assert_says
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.command_line import app
from truing.pipeline.in_memory import axis_tables
from truing.pipeline.power_command import diagnosed
from truing.simulation.axis.causes import LostMotion, ScaleError
from truing.simulation.cause import Effect
from truing.simulation.detection_trials import Trial
from truing.stages.diagnosis.search import assembled_data, search_causes
from truing.stages.power import axis_plan_of

UNEVEN = (0.0, 17.0, 61.0, 94.0, 131.0, 168.0, 209.0, 243.0, 288.0, 332.0, 377.0, 400.0)
TOML = """format = 1
[campaign]
name = "{name}"
kind = "photogrammetry"
[mechanism]
type = "axis"
kind = "linear"
command = "command_mm"
{keys}
[noise]
measured_mm = 0.0005
"""


def call(*words: object) -> Result:
    return CliRunner().invoke(app, list(map(str, words)))


def commands(targets: tuple[float, ...] = UNEVEN, cycles: int = 3) -> list[float]:
    """Cycles up and down, with turns beyond the ends."""
    return [*targets, 415.0, *targets[::-1], -15.0] * cycles


def planned(folder: Path, rows: list[float], keys: str = "") -> Path:
    """An axis before any measurement: commands alone, and the noise of the outside instrument."""
    folder.mkdir()
    (folder / "campaign.toml").write_text(TOML.format(name=folder.name, keys=keys))
    lines = [f"{number},{command}" for number, command in enumerate(rows, 1)]
    (folder / "configurations.csv").write_text("\n".join(["pose,command_mm", *lines]) + "\n")
    return folder


def sizes(folder: Path, *words: object) -> dict[tuple[str, str], dict[str, object]]:
    out = folder.with_name(f"{folder.name}-power.csv")
    done = call("power", folder, "--draws", 0, "--out", out, *words)
    assert done.exit_code == 0, done.output
    return {(row["cause"], row["concerns"]): row for row in pyarrow.csv.read_csv(out).to_pylist()}


def test_twice_the_cycles_lower_every_detectable_size_by_the_square_root_of_two(tmp_path: Path) -> None:
    """The noise is estimated from one drawn campaign of 156 or 312 rows: six and four per cent, in each of three."""
    folders = [planned(tmp_path / f"of{cycles}", commands(cycles=cycles)) for cycles in (6, 12)]
    found = [[sizes(folder, "--seed", seed) for seed in range(3)] for folder in folders]
    for key in (("scale-error", "one axis"), ("lost-motion", "the whole"), ("periodic-error", "one axis")):
        few, many = (np.mean([rows[key]["expected_80"] for rows in of_folder]) for of_folder in found)
        assert few / many == pytest.approx(np.sqrt(2.0), rel=0.12)


def test_half_the_noise_halves_every_detectable_size_but_for_the_odds_that_a_found_effect_needs(tmp_path: Path) -> None:
    """Twice the precision doubles the number of sizes that an effect may have. Its odds fall by log 2 for each of its
    two parameters at most. So a found one needs up to 4 log 2 more in its squares, which are 25 or more."""
    coarse, fine = planned(tmp_path / "coarse", commands()), planned(tmp_path / "fine", commands())
    text = (fine / "campaign.toml").read_text()
    (fine / "campaign.toml").write_text(text.replace("0.0005", "0.00025"))
    rows, others = sizes(coarse), sizes(fine)
    assert set(rows) == set(others)
    for key, row in rows.items():
        assert (
            1.0 - 1e-3 < 2.0 * others[key]["expected_80"] / row["expected_80"] < np.sqrt(1.0 + 4.0 * np.log(2.0) / 25.0)
        )


def test_commands_at_multiples_of_the_period_show_no_periodic_error(tmp_path: Path) -> None:
    even = tuple(np.arange(0.0, 401.0, 50.0).tolist())
    key = ("periodic-error", "one axis")
    at_multiples = [c if 0.0 <= c <= 400.0 else 25.0 * round(c / 25.0) for c in commands(even)]
    shown = sizes(planned(tmp_path / "even", at_multiples, "period_mm = 25.0"))
    assert shown[key]["expected_80"] is None
    assert shown["lost-motion", "the whole"]["expected_80"] > 0.0
    assert sizes(planned(tmp_path / "uneven", commands(), "period_mm = 25.0"))[key]["expected_80"] < 0.01


def test_hidden_effects_are_recovered_from_drawn_rows(tmp_path: Path) -> None:
    """Also in counts: what is drawn is written in the unit of the column, and read back."""
    keys = 'motor = "motor_counts"\ncounts_per_mm = 2000.0'
    folder = planned(tmp_path / "counts", commands(), keys)
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(f"{text}motor_mm = 0.0002\ncommand_mm = 0.001\n")
    settings = open_campaign(folder).validated()
    plan = axis_plan_of(axis_tables(open_campaign(folder), settings), settings)
    assert plan.columns.encoders == {"motor": "motor_counts", "measured": "measured_mm"}
    hidden = [
        Effect(ScaleError(kind_of_axis="linear"), np.array([3e-5])),
        Effect(LostMotion("linear"), np.array([3e-6])),
    ]
    found: dict[str, list[float]] = {"scale-error": [], "lost-motion": []}
    for seed in range(6):
        tables = plan.drawn(hidden, np.random.default_rng(seed))
        assert "event" not in tables["configurations"].column_names
        for verdict in search_causes(assembled_data(tables, settings), settings, lambda *_: None).verdicts:
            if verdict.verdict == "found":
                size = next(effect.values[0] for effect in hidden if effect.cause.id == verdict.cause.id)
                found[verdict.cause.id].append((verdict.values[0] - size) / np.sqrt(verdict.covariance[0, 0]))
    for off in found.values():
        assert len(off) >= 4  # a test of the model as a whole fails by chance in some, and leaves both suspected
        assert np.abs(off).max() < 4.0


def test_a_measured_campaign_keeps_its_rows_and_gaps(tmp_path: Path) -> None:
    """Rows without a reading stay without one, and the outside instrument that was not used is not drawn."""
    layout = AxisLayout(
        "rotary",
        "motor",
        ("motor", "load"),
        np.array([*range(-80, 90, 20), *range(80, -90, -20)] * 2, float),
        {"command": 1e-3, "motor": 3e-4, "load": 1e-3, "measured": 1e-3},
        None,
        np.arange(36) % 5 == 3,
    )
    folder = write(record(layout, (), np.random.default_rng(2)), tmp_path / "measured")
    file = folder / "configurations.csv"
    lines = file.read_text().splitlines()
    lines[4] = ",".join([*lines[4].split(",")[:4], "", *lines[4].split(",")[5:]])
    file.write_text("\n".join(lines) + "\n")
    settings = open_campaign(folder).validated()
    table = axis_tables(open_campaign(folder), settings)["configurations"]
    drawn = axis_plan_of({"configurations": table}, settings).drawn((), np.random.default_rng(1))["configurations"]
    assert drawn.schema.names == table.schema.names
    assert drawn.column("motor_deg").null_count == table.column("motor_deg").null_count == 1
    assert pa.compute.max(pa.compute.abs(pa.compute.subtract(drawn["load_deg"], table["command_deg"]))).as_py() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_an_independent_generator_finds_a_size_as_often_as_drawn_campaigns(factor: float, tmp_path: Path) -> None:
    """Lost motion below and above the theoretical size, hidden there by closing the loop row by row.

    Few causes are searched: both generators meet the same search.
    """
    folder, tried = search_only(planned(tmp_path / "stage", commands()), "lost-motion", "scale-error"), 12
    size_mm = factor * float(sizes(folder)["lost-motion", "the whole"]["expected_80"])
    settings = open_campaign(folder).validated()
    plan = axis_plan_of(axis_tables(open_campaign(folder), settings), settings)
    table = plan.tables["configurations"]
    command = table.column("command_mm").to_numpy()
    noise = {"command": 0.0, "motor": 0.0, "load": 0.0, "measured": 0.0005}
    layout = AxisLayout("linear", "motor", ("measured",), command, noise, None, np.zeros(len(command), bool))
    effect = Effect(LostMotion(kind_of_axis="linear"), np.array([1e-3 * size_mm]))
    trial, column = Trial(0, factor, (effect,), ()), table.schema.get_field_index("measured_mm")
    found = np.zeros(2, int)
    for seed in range(tried):
        recorded = record(layout, (Hidden("lost-motion", "", size_mm),), np.random.default_rng([1, seed])).recorded
        independent = {"configurations": table.set_column(column, "measured_mm", pa.array(recorded[:, 0]))}
        drawn = plan.drawn((effect,), np.random.default_rng([2, seed]))
        found += [diagnosed(tables, settings, trial).found for tables in (independent, drawn)]
    assert fisher_exact([found, tried - found]).pvalue > 0.002
    assert (found < tried).all() if factor < 1.0 else (found >= tried // 2).all()


def test_draws_and_gross_errors_are_accepted(tmp_path: Path) -> None:
    folder = planned(tmp_path / "stage", commands())
    out = tmp_path / "power.csv"
    words = ("--causes", "lost-motion", "--draws", 1, "--gross", 0.01, "--workers", 1, "--out", out)
    done = call("power", folder, *words)
    assert done.exit_code == 0, done.output
    rates = pyarrow.csv.read_csv(tmp_path / "power-rates.csv").to_pylist()
    assert [row["cause"] for row in rates] == ["nothing", *["lost-motion"] * 5]
    assert "lost motion" in (tmp_path / "power.html").read_text()


def test_a_plan_needs_commands_and_the_noise_of_an_encoder(tmp_path: Path) -> None:
    folder = planned(tmp_path / "stage", commands())
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(text.replace("measured_mm = 0.0005", ""))
    done = call("power", folder, "--draws", 0)
    assert done.exit_code == 2
    assert_says(" ".join(done.output.split()), "noise.measured_mm")
    (folder / "campaign.toml").write_text(text)
    (folder / "configurations.csv").unlink()
    done = call("power", folder, "--draws", 0)
    assert done.exit_code == 2
    assert_says(" ".join(done.output.split()), "configurations.csv")
