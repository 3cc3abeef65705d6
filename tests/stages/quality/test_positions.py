"""Positioning runs: silent on good ones, each slip is named, and no accuracy is stated for a failed run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.sentences import assert_says
from tests.tolerance import assert_close
from truing.pipeline.in_memory import StageLine, stage_line
from truing.stages.quality.check import CampaignLimits
from truing.stages.quality.position_checks import PositioningRun, position_checks

WAYS = ("forward", "backward")
LIMITS = CampaignLimits("interferometer")
STEP_MM = 1e-4
HEAD = "run,target_mm,direction,cycle,position_mm"
TOML = '[campaign]\nname = "axis"\nkind = "interferometer"\n'

Row = list
Slip = Callable[[list[Row]], None]


def approaches(seed: int = 0, targets: int = 8, cycles: int = 5, scatter_um: float = 0.5) -> list[Row]:
    """Rows target, direction, cycle, position in the order taken: up and down again, cycle by cycle."""
    rng = np.random.default_rng(seed)
    target = np.linspace(15.0, 155.0, targets)
    error = np.cumsum(rng.normal(0.0, 2.0, targets))
    rows = []
    for cycle in range(1, cycles + 1):
        for way, side in (("forward", 2.0), ("backward", -2.0)):
            for k in range(targets) if way == "forward" else reversed(range(targets)):
                position = target[k] + 1e-3 * (error[k] + side + rng.normal(0.0, scatter_um))
                rows.append([float(target[k]), way, cycle, round(position / STEP_MM) * STEP_MM])
    return rows


def verdicts(rows: list[Row]) -> dict[str, tuple[str, str]]:
    """Verdict and message of every check of these rows as one run."""
    targets, cycles = sorted({row[0] for row in rows}), sorted({row[2] for row in rows})
    position = np.full((len(targets), 2, len(cycles)), np.nan)
    order = np.zeros(position.shape, dtype=np.int64)
    for number, (target, way, cycle, at) in enumerate(rows):
        place = targets.index(target), WAYS.index(way), cycles.index(cycle)
        position[place], order[place] = at, number
    run = PositioningRun("X", np.array(targets), position, position, order, tuple(cycles), None)
    return {check.check: (check.verdict, check.message) for check in position_checks([run], LIMITS)}


def all_by(change: Callable[[Row], float]) -> Slip:
    def slip(rows: list[Row]) -> None:
        for row in rows:
            row[3] = change(row)

    return slip


def from_row(number: int, by_mm: float) -> Slip:
    def slip(rows: list[Row]) -> None:
        for row in rows[number:]:
            row[3] += by_mm

    return slip


def one_row(number: int, by_mm: float) -> Slip:
    def slip(rows: list[Row]) -> None:
        rows[number][3] += by_mm

    return slip


def shifted(by: int) -> Slip:
    def slip(rows: list[Row]) -> None:
        for row, at in zip(rows, np.roll([row[3] for row in rows], by), strict=True):
            row[3] = float(at)

    return slip


def copied(into: int) -> Slip:
    def slip(rows: list[Row]) -> None:
        first = {(row[0], row[1]): row[3] for row in rows if row[2] == 1}
        for row in rows:
            if row[2] == into:
                row[3] = first[row[0], row[1]]

    return slip


def copied_ways(rows: list[Row]) -> None:
    forward = {(row[0], row[2]): row[3] for row in rows if row[1] == "forward"}
    for row in rows:
        row[3] = forward[row[0], row[2]]


def frozen(rows: list[Row]) -> None:
    rows[19][3] = rows[20][3] = rows[18][3]


def turned(cycles: tuple[int, ...]) -> Slip:
    def slip(rows: list[Row]) -> None:
        for row in rows:
            if row[2] in cycles:
                row[1] = WAYS[1 - WAYS.index(row[1])]

    return slip


def exchanged(rows: list[Row]) -> None:
    rows[20][3], rows[22][3] = rows[22][3], rows[20][3]


SLIPS: list[tuple[Slip, str, str, str]] = [
    (all_by(lambda row: 1e-3 * row[3]), "positions-against-targets", "fail", "by 1000 (metres in place of mm)?"),
    (all_by(lambda row: row[3] / 25.4), "positions-against-targets", "fail", "by 25.4 (inches in place of mm)?"),
    (all_by(lambda row: -row[3]), "positions-against-targets", "fail", "with the opposite sign?"),
    (all_by(lambda row: row[3] - row[0]), "positions-against-targets", "fail", "They seem to be deviations"),
    (all_by(lambda row: 1e3 * (row[3] - row[0])), "positions-against-targets", "fail", "They seem to be deviations"),
    (all_by(lambda row: 20.0), "positions-against-targets", "fail", "frozen"),
    (shifted(1), "positions-against-targets", "fail", "shifted by +1 rows?"),
    (shifted(-1), "positions-against-targets", "fail", "shifted by -1 rows?"),
    (from_row(30, STEP_MM * 2**16), "encoder-overflow", "fail", "2^16 steps of 0.1 um"),
    (from_row(40, STEP_MM * 2**31), "encoder-overflow", "fail", "2^31 steps of 0.1 um"),
    (from_row(30, STEP_MM * 2**32), "encoder-overflow", "fail", "2^32 steps of 0.1 um"),
    (one_row(30, -STEP_MM * 2**16), "encoder-overflow", "fail", "at target 35 mm backward in cycle 2."),
    (from_row(30, 0.1), "position-jumps", "fail", "from target 35 mm backward in cycle 2 on"),
    (all_by(lambda row: row[3] + 1.0 * (row[0] == 55.0)), "position-jumps", "fail", "Separate: all of target 55 mm."),
    (one_row(30, 0.02), "position-errors", "fail", "is target 35 mm backward in cycle 2"),
    (exchanged, "positions-against-targets", "fail", "exchanged rows: row 21 and row 23?"),
    (one_row(30, 30.0), "positions-against-targets", "warn", "Row 31 alone is far from the target"),
    (copied(3), "copied-approaches", "fail", "forward in cycle 1 and forward in cycle 3"),
    (copied_ways, "copied-approaches", "fail", "forward in cycle 1 and backward in cycle 1"),
    (frozen, "copied-approaches", "fail", "from one target to another: target 75 mm forward in cycle 2"),
    (turned((3,)), "approach-directions", "fail", "in cycle 3 forward and backward are exchanged"),
    (turned((1, 2, 3, 4, 5)), "approach-directions", "warn", "forward and backward are exchanged"),
    (all_by(lambda row: row[3] + 2e-3 * row[2]), "position-drift", "warn", "of their differences between cycles."),
]  # fmt: skip


@pytest.mark.parametrize(
    ("slip", "check", "verdict", "said"), SLIPS, ids=lambda one: one if isinstance(one, str) else ""
)
def test_a_slip_is_found_by_name(slip, check, verdict, said):
    for seed in range(3):
        rows = approaches(seed)
        slip(rows)
        found = verdicts(rows)[check]
        assert found[0] == verdict, (seed, found)
        assert said in found[1]


def test_a_jump_between_cycles_is_found_in_a_file_that_is_sorted_by_target():
    rows = approaches()
    from_row(32, 0.02)(rows)
    verdict, said = verdicts(sorted(rows))["position-jumps"]
    assert verdict == "fail"
    assert "from target 15 mm forward in cycle 3 on, in the order of the cycles" in said


@pytest.mark.parametrize("way", [lambda row: (row[2], row[1] == "backward", row[0]), lambda row: row[:3]])
def test_rows_that_do_not_show_movements_give_no_directions(way):
    rows = approaches()
    for slip in (None, turned((1, 2, 3, 4, 5))):
        if slip:
            slip(rows)
        verdict, said = verdicts(sorted(rows, key=way))["approach-directions"]
        assert verdict == "not evaluated"
        assert_says(said, "order of the rows", "not show")
    assert verdicts(approaches())["approach-directions"][0] == "pass"


def test_good_runs_of_every_size_are_silent():
    shapes = [(3, 2, 1.0), (3, 5, 0.02), (5, 5, 0.3), (8, 3, 5.0), (11, 5, 0.5), (21, 7, 2.0)]
    reported = [
        (shape, seed, check, found)
        for shape in shapes
        for seed in range(15)
        for check, found in verdicts(approaches(seed, *shape)).items()
        if found[0] in ("fail", "warn") and check not in ("approach-cycles", "copied-approaches")
    ]
    assert reported == []


def test_deviations_too_small_for_light_in_air_are_likely_in_another_unit():
    rows = [[target, way, cycle, target + 4e-4 * (at - target)] for target, way, cycle, at in approaches()]
    verdict, said = verdicts(rows)["positions-against-targets"]
    assert verdict == "warn"
    assert_says(said, "wavelength of light", "did you mean mm")


def test_a_reading_coarser_than_the_axis_gives_no_repeatability():
    rows = approaches(scatter_um=0.001)
    assert verdicts(rows)["copied-approaches"][0] == "fail"


def test_fewer_than_five_cycles_warn():
    assert verdicts(approaches(cycles=2))["approach-cycles"][0] == "warn"


def written(folder: Path, runs: dict[str, list[Row]], more: str = "") -> StageLine:
    lines = [f"{name},{t},{way},{cycle},{at:.6f}" for name, rows in runs.items() for t, way, cycle, at in rows]
    (folder / "positioning.csv").write_text("\n".join([HEAD, *lines]) + "\n")
    (folder / "campaign.toml").write_text(TOML + more)
    return stage_line(folder).call("ingest", "qa", "deformation", "uncertainty")


def test_a_run_that_fails_has_no_accuracy_and_the_other_has_its_own(tmp_path):
    bad = approaches(1)
    from_row(30, STEP_MM * 2**31)(bad)
    line = written(tmp_path, {"X": approaches(0), "Y": bad})
    assert line.outcomes["qa"].failed_checks == ("encoder-overflow run Y", "positions-against-targets run Y")
    rows = line.tables["positioning"].to_pylist()
    assert {row["run"] for row in rows} == {"X"}
    alone = {(r["figure"], r["subject"]): r["value"] for r in rows}
    assert 4.0 < alone["A", None] < 30.0
    assert "not evaluated: Run Y: positions jump by 214748 mm, 2^31 steps" in line.outcomes["deformation"].figure
    reported = [
        row for row in line.tables["uncertainty"].to_pylist() if row["result"] == "positioning" and row["subject"]
    ]
    assert {row["subject"]: row["stated"] for row in reported} == {"run X": True, "run Y": False}


def test_a_verdict_that_a_person_accepts_states_the_accuracy(tmp_path):
    rows = approaches(2)
    one_row(30, 0.02)(rows)
    accept = '[[accept]]\ncheck = "position-errors"\nsubject = "run X"\nreason = "seen"\nby = "A. B."\n'
    assert written(tmp_path, {"X": rows}).tables["positioning"].num_rows == 0
    assert written(tmp_path, {"X": rows}, accept).tables["positioning"].num_rows > 0


def test_copied_positions_are_found_before_temperature_correction(tmp_path):
    """Copied readings differ once each is brought to 20 degrees by a temperature of its own."""
    rows = approaches(0)
    copied(3)(rows)
    lines = [f"X,{t},{way},{cycle},{at:.6f},{20.0 + 0.01 * n}" for n, (t, way, cycle, at) in enumerate(rows)]
    (tmp_path / "positioning.csv").write_text("\n".join([f"{HEAD},material_temperature_c", *lines]) + "\n")
    (tmp_path / "campaign.toml").write_text(TOML + "[interferometer.material]\naxis = { expansion_per_k = 1.15e-5 }\n")
    line = stage_line(tmp_path).call("ingest", "qa")
    assert "copied-approaches run X" in line.outcomes["qa"].failed_checks
    read = line.tables["positions"].column("position_read_mm").to_numpy()
    assert_close(np.sort(read), np.sort([row[3] for row in rows]), atol=1e-9)


def test_fahrenheit_is_no_temperature_of_an_axis(tmp_path):
    lines = [f"X,{t},{way},{cycle},{at:.6f},68.5" for t, way, cycle, at in approaches(0)]
    (tmp_path / "positioning.csv").write_text("\n".join([f"{HEAD},material_temperature_c", *lines]) + "\n")
    (tmp_path / "campaign.toml").write_text(TOML)
    assert stage_line(tmp_path).call("ingest", "qa").outcomes["qa"].failed_checks == ("axis-temperature run X",)
