"""A column partly or wholly in another unit is named with its rows, the unit and the remedy."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.blind.generator.campaign import draw_campaign
from tests.blind.generator.folder import write_campaign
from tests.blind.generator.layout import Layout, Targets
from tests.blind.generator.schedule import random_moves
from tests.stages.line import run_line
from truing.estimation.suspect_units import SECONDS_PER_UNIT, mistaken_times
from truing.pipeline.command_line import app

CHECKED = ("temperature-unit", "time-unit")


def campaign(folder: Path, column: str = "", change: Callable[[np.ndarray], np.ndarray] | None = None) -> Path:
    """A good campaign of 24 poses, with a column of its configurations changed."""
    numbers = np.random.default_rng(3)
    moves = random_moves(24, 0, numbers)
    layout = Layout(name="u", targets=Targets(per_leg=0))
    made = write_campaign(draw_campaign(layout, moves, [], numbers), folder, 3)
    if change is not None:
        file = made / "configurations.csv"
        with file.open(encoding="utf-8", newline="") as text:
            rows = list(csv.DictReader(text))
        values = change(np.array([float(row[column]) for row in rows]))
        with file.open("w", encoding="utf-8", newline="") as text:
            writer = csv.DictWriter(text, list(rows[0]))
            writer.writeheader()
            writer.writerows({**row, column: repr(float(v))} for row, v in zip(rows, values, strict=True))
    return made


def half_in_fahrenheit(celsius: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(celsius)) < 12, celsius, np.round(1.8 * celsius + 32.0, 2))


@pytest.mark.parametrize(
    ("column", "change", "check", "verdict", "expected"),
    [
        ("temperature_c", half_in_fahrenheit, CHECKED[0], "fail", ["degrees Fahrenheit", "12 of 24 rows"]),
        ("time_s", lambda t: 45000.4 + t / 86400.0, CHECKED[1], "warn", ["days", 'units = { time_s = "d" }']),
        ("time_s", lambda t: 1e9 * (1.7e9 + t), CHECKED[1], "warn", ["nanoseconds", "scale = 1e-09"]),
        ("", None, "", "", []),
    ],
)
def test_qa_and_check_name_unit_rows_and_cure(tmp_path, column, change, check, verdict, expected):
    made = campaign(tmp_path / "c", column, change)
    qa = run_line(made, "ingest", "qa")[0]["qa"].to_pandas().set_index("check")
    verdicts = {name: qa.loc[name, "verdict"] for name in CHECKED}
    assert verdicts == {name: verdict if name == check else "pass" for name in CHECKED}
    lines = CliRunner().invoke(app, ["check", str(made)]).output.splitlines()
    said = [line for line in lines if line.startswith("attention: ") and "likely in" in line]
    assert len(said) == bool(check)
    for words in expected:
        assert words in qa.loc[check, "message"]
        assert words in said[0]


def test_the_rows_in_fahrenheit_are_named_by_their_poses(tmp_path):
    made = campaign(tmp_path / "c", "temperature_c", half_in_fahrenheit)
    with (made / "configurations.csv").open(encoding="utf-8", newline="") as text:
        poses = [row["pose"] for row in csv.DictReader(text)]
    qa = run_line(made, "ingest", "qa")[0]["qa"].to_pandas().set_index("check")
    assert f"pose {poses[12]} to pose {poses[23]}" in qa.loc["temperature-unit", "message"]


def good_times(rng: np.random.Generator) -> np.ndarray:
    """Seconds as people, robots and clocks write them."""
    n = int(rng.integers(6, 150))
    hands = np.cumsum(np.exp(rng.uniform(np.log(2.0), np.log(1800.0))) * rng.uniform(0.5, 1.8, n))
    days = np.cumsum((rng.uniform(size=n) < 0.05) * rng.uniform(3600.0, 250_000.0, n))
    kinds = (
        hands,
        np.round(hands) + rng.choice([0.0, 45_000.0, 1.7e9, 3.9e9]),
        hands + days,
        np.arange(n) / rng.choice([10.0, 50.0, 120.0, 1000.0]) + rng.choice([0.0, 40_000.0]),
        86400.0 * np.arange(n) * rng.choice([1.0, 7.0]) + rng.uniform(0.0, 7200.0, n),
        np.arange(n) * rng.choice([60.0, 240.0, 3600.0, 21_600.0]),
    )
    return np.asarray(kinds[int(rng.integers(len(kinds)))])


def test_two_hundred_good_columns_of_times_pass():
    rng = np.random.default_rng(17)
    assert not [k for k in range(200) if mistaken_times(good_times(rng)) is not None]


@pytest.mark.parametrize(
    ("unit", "start"),
    [
        *(("d", 45_000.3), ("d", 738_000.3), ("d", 0.3), ("h", 0.0), ("ms", 0.0), ("ms", 1.7e12)),
        *(("us", 1.7e15), ("100 ns", 6.38e17), ("ns", 0.0), ("ns", 1.7e18)),
    ],
)
def test_times_in_another_unit_are_reported(unit, start):
    pace = np.random.default_rng(4).uniform(150.0, 400.0, 40)
    found = mistaken_times(start + np.cumsum(pace) / SECONDS_PER_UNIT[unit])
    assert found is not None
    assert found.unit == unit


@pytest.mark.parametrize(("pace_s", "hours"), [(90.0, 25), (36.0, 10)])
def test_an_even_pace_of_whole_hours_that_is_no_daily_one_is_in_milliseconds(pace_s: float, hours: int) -> None:
    found = mistaken_times(pace_s / SECONDS_PER_UNIT["ms"] * np.arange(40.0))
    assert found is not None, f"every {hours} hours, day and night"
    assert found.unit == "ms"
    assert mistaken_times(3600.0 * 6.0 * np.arange(40.0)) is None, "four times a day"


def test_minutes_at_a_pace_of_seconds_are_not_reported():
    assert mistaken_times(np.cumsum(np.random.default_rng(4).uniform(150.0, 400.0, 40)) / 60.0) is None
