"""`truing design` for a single axis: chosen targets, visits from both sides, aliases, and bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.csv
import pytest
from click.testing import Result
from typer.testing import CliRunner

from tests.sentences import assert_says
from truing.calibration.axis_design import TURNING, lattice_step, targets_within, visited
from truing.pipeline.command_line import app
from truing.simulation.axis.rows import approaches

LOW, HIGH, CYCLES = -100.0, 300.0, 4
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
TRAVEL = f"travel_mm = [{LOW}, {HIGH}]"


def call(*words: object, command: str = "design") -> Result:
    return CliRunner().invoke(app, [command, *map(str, words)])


def axis(folder: Path, keys: str = TRAVEL, rows: list[float] | None = None) -> Path:
    folder.mkdir()
    (folder / "campaign.toml").write_text(TOML.format(name=folder.name, keys=keys))
    if rows is not None:
        lines = [f"{number},{command}" for number, command in enumerate(rows, 1)]
        (folder / "configurations.csv").write_text("\n".join(["pose,command_mm", *lines]) + "\n")
    return folder


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("designed")
    out = folder / "plan.csv"
    done = call(axis(folder / "stage"), "--poses", 90, "--cycles", CYCLES, "--verification", 4, "--out", out)
    assert done.exit_code == 0, done.output
    return out, " ".join(done.output.split())


def plan(out: Path, role: str) -> np.ndarray:
    table = pyarrow.csv.read_csv(out)
    return table["command_mm"].to_numpy()[np.array(table["role"].to_pylist()) == role]


def test_every_target_is_visited_from_both_sides_in_every_cycle(designed: tuple[Path, str]) -> None:
    table = pyarrow.csv.read_csv(designed[0])
    command, fitted = table["command_mm"].to_numpy(), np.array(table["role"].to_pylist()) == "calibration"
    direction, _ = approaches(command, np.arange(len(command)), 0.0)
    targets = np.unique(command[fitted & (command > LOW) & (command < HIGH)])
    assert len(targets) == 10  # 4 cycles of 10 targets from both sides and 2 turns: 88 of 90 readings
    for target in targets:
        ways = direction[fitted & (command == target)]
        assert (ways == 1.0).sum() == (ways == -1.0).sum() == CYCLES


def test_targets_lie_one_in_each_part_of_the_travel(designed: tuple[Path, str]) -> None:
    targets = np.setdiff1d(plan(designed[0], "calibration"), [LOW, HIGH])
    margin = TURNING * (HIGH - LOW)
    parts = np.floor((targets - LOW - margin) / (HIGH - LOW - 2.0 * margin) * len(targets))
    assert parts.tolist() == list(range(len(targets)))


def test_rows_for_verification_are_new_targets_from_both_sides(designed: tuple[Path, str]) -> None:
    held_out = np.setdiff1d(plan(designed[0], "verification"), [LOW, HIGH])
    fitted = plan(designed[0], "calibration")
    assert len(held_out) == 2
    assert np.abs(held_out[:, None] - fitted).min() > 0.02 * (HIGH - LOW)


def test_chosen_targets_determine_more_than_equal_steps_and_lie_on_no_lattice(designed: tuple[Path, str]) -> None:
    out, output = designed
    assert lattice_step(np.setdiff1d(plan(out, "calibration"), [LOW, HIGH])) is None
    share = float(output.split("D-efficiency ")[1].split(" %")[0])
    even = float(output.split("equal steps have ")[1].split(" %")[0])
    assert even < share <= 100.0


def test_the_plan_shows_what_power_expects_of_it(designed: tuple[Path, str], tmp_path: Path) -> None:
    """The table next to the plan holds the sizes of `truing power` for the same rows."""
    folder = axis(tmp_path / "stage")
    (folder / "configurations.csv").write_text(designed[0].read_text())
    assert call(folder, "--draws", 0, "--out", tmp_path / "power.csv", command="power").exit_code == 0
    expected = pyarrow.csv.read_csv(tmp_path / "power.csv").to_pylist()
    shown = pyarrow.csv.read_csv(designed[0].with_name("plan-causes.csv")).to_pylist()
    assert {row.pop("poses") for row in shown} == {"plan"}
    assert shown == expected


@pytest.mark.parametrize(("step", "count"), [(10.0, 9), (25.0, 4), (0.5, 40)])
def test_equal_steps_are_a_lattice_of_that_step(step: float, count: int) -> None:
    """Also with gaps, and from any start; a sine of that period is then the same at all positions."""
    positions = 3.7 + step * np.setdiff1d(np.arange(count), [2] if count > 4 else [])
    found = lattice_step(positions)
    assert found == pytest.approx(step, rel=2e-3)
    assert np.ptp(np.sin(2.0 * np.pi * positions / step + 0.3)) < 1e-9


def test_uneven_positions_are_no_lattice() -> None:
    for seed in range(20):
        assert lattice_step(np.sort(np.random.default_rng(seed).uniform(0.0, 400.0, 9))) is None


def test_equal_commands_of_the_campaign_are_reported_with_their_step(tmp_path: Path) -> None:
    up = np.arange(0.0, 401.0, 40.0).tolist()
    folder = axis(tmp_path / "even", "period_mm = 40.0", [*up, *up[::-1]] * 3)
    done = call(folder, "--poses", 60, "--out", tmp_path / "plan.csv")
    assert done.exit_code == 0, done.output
    assert_says(" ".join(done.output.split()), "own commands", "multiples of 40 mm", "periodic error")
    rows = pyarrow.csv.read_csv(tmp_path / "plan-causes.csv").to_pylist()
    seen = {row["poses"]: row["expected_80"] for row in rows if row["cause"] == "periodic-error"}
    assert seen["own"] is None
    assert seen["plan"] < 0.01


def test_readings_of_the_standard_are_five_cycles_of_at_least_five_targets(tmp_path: Path) -> None:
    """As many cycles as the readings allow, at most five; each more cycle leaves at least five targets."""
    for readings, cycles in ((60, 5), (59, 4), (12, 1)):
        done = call(axis(tmp_path / f"of{readings}"), "--poses", readings, "--json")
        assert done.exit_code == 0, done.output
        command = [row["command_mm"] for row in json.loads(done.output)["chosen"]]
        assert len(command) <= readings
        assert command.count(command[1]) == 2 * cycles
        assert len(set(command) - {LOW, HIGH}) >= 5


def test_visits_take_at_most_the_readings_that_are_given() -> None:
    for readings in range(20, 300, 7):
        for cycles in (1, 2, 5):
            count = targets_within(readings, cycles)
            lengths = [len(visited(np.zeros(n), cycles, 0.0, 1.0)) for n in (count, count + 1)]
            assert lengths[0] <= readings < lengths[1]


def test_kept_rows_lower_the_need_for_others(tmp_path: Path) -> None:
    """Numbers go on after those of the kept table."""
    folder, kept = axis(tmp_path / "stage"), tmp_path / "kept.csv"
    assert call(folder, "--poses", 60, "--out", kept).exit_code == 0
    done = call(folder, "--poses", 60, "--extend", kept, "--seed", 1, "--out", tmp_path / "more.csv")
    assert done.exit_code == 0, done.output
    assert_says(" ".join(done.output.split()), "60 rows that are kept")
    assert pyarrow.csv.read_csv(tmp_path / "more.csv")["pose"][0].as_py() == 61


def test_a_rotary_axis_is_planned_in_degrees(tmp_path: Path) -> None:
    text = TOML.format(name="turn", keys="travel_deg = [0.0, 360.0]")
    folder = tmp_path / "turn"
    folder.mkdir()
    (folder / "campaign.toml").write_text(text.replace("_mm", "_deg").replace("linear", "rotary"))
    done = call(folder, "--poses", 96, "--out", tmp_path / "plan.csv")
    assert done.exit_code == 0, done.output
    command = pyarrow.csv.read_csv(tmp_path / "plan.csv")["command_deg"].to_numpy()
    assert (command.min(), command.max()) == (0.0, 360.0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--avoid", "x.csv"), ("--avoid", "travel_mm")),
        (("--parameters", "a_x"), ("--parameters",)),
        (("--method", "direct"), ("--method", "exchange or random")),
        (("--causes", "axis-growth"), ("--causes", "scale-error", "lost-motion", "periodic-error")),
        (("--poses", 20, "--cycles", 3), ("--poses", "at least 36 readings")),
    ],
)
def test_options_without_meaning_for_an_axis_are_refused(
    words: tuple[object, ...], said: tuple[str, ...], tmp_path: Path
) -> None:
    done = call(axis(tmp_path / "stage"), *words)
    assert done.exit_code == 2, done.output
    assert_says(" ".join(done.output.split()), *said)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("", "mechanism.travel_mm"),
        ("travel_mm = [3.0, 1.0]", "travel_mm"),
        ("travel_deg = [0.0, 1.0]", "travel_mm"),
    ],
)
def test_the_travel_must_be_known(keys: str, said: str, tmp_path: Path) -> None:
    done = call(axis(tmp_path / "stage", keys))
    assert done.exit_code == 2, done.output
    assert_says(" ".join(done.output.split()), said)


def test_an_encoder_that_follows_the_command_shows_nothing(tmp_path: Path) -> None:
    folder = axis(tmp_path / "stage", f'motor = "motor_mm"\n{TRAVEL}')
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(text.replace("measured_mm = ", "motor_mm = "))
    done = call(folder)
    assert done.exit_code == 2, done.output
    assert_says(" ".join(done.output.split()), "outside instrument")
