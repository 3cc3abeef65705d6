"""Numbers of a chain that measurements do not separate: each combination moves no tip, other poses are named where they
help."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.blind.generator.arms.draw import draw, record
from tests.blind.generator.arms.folder import write
from tests.ignored_causes import search_only
from truing.pipeline.command_line import app
from truing.report.chain_inseparable import inseparable_listing
from truing.runs.recorded_run import load
from truing.simulation.mechanisms.chains.extended_model import ExtendedChain
from truing.simulation.mechanisms.chains.tree import axis_twist

COMPONENTS = ("dx", "dy", "dz", "turn_x", "turn_y", "turn_z")
STILL = 3  # joint4 in the second campaign


def _run(folder: Path) -> Path:
    out = search_only(folder).with_name(f"{folder.name}-run")
    done = CliRunner().invoke(app, ["run", str(folder), "--out", str(out), "--qa", "warn"])
    assert done.exit_code == 0, done.output
    return out


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """An arm of Denavit and Hartenberg rows, whose joints 2 to 4 are parallel: all joints move, or one stands still."""
    made = draw(3, layout="offset-wrist-6r", instrument="points-campaign", notation="standard", causes=(), poses=50)
    home, bench = tmp_path_factory.mktemp("arms"), made.bench
    still = bench.schedule.readings.copy()
    still[:, STILL] = 0.4
    halted = replace(bench, schedule=replace(bench.schedule, readings=still))
    second = record(3, made.layout, halted, (), np.random.default_rng(5))
    folders = {"moving": write(made, home / "moving"), "still": write(second, home / "still")}
    return {name: _run(folder) for name, folder in folders.items()}


def _combinations(run: Path) -> list[pd.DataFrame]:
    table = pq.read_table(run / "chain_inseparable.parquet").to_pandas()
    return [group for _, group in table.groupby("combination_number")]


def _tip_moves(model: ExtendedChain, group: pd.DataFrame, readings: np.ndarray) -> float:
    """Largest motion of the tip, m, by 1e-3 of the combination, relative to that of its first member alone."""
    tree, node_of = model.tree, {node.joint: k for k, node in enumerate(model.tree.nodes) if node.joint}
    moved = []
    for members in (group, group.iloc[:1]):
        twists = np.zeros((1, tree.size, 6))
        for row in members.itertuples():
            k, size = node_of[row.subject], 1e-3 * row.number_change * (1e-3 if row.unit == "mm" else 1.0)
            if row.parameter == "offset":
                twists[0, k] += size * axis_twist(tree.nodes[k])
            else:
                twists[0, k, COMPONENTS.index(row.parameter)] += size
        gap = tree.frames(readings, twists).t[:, model.tip] - tree.frames(readings).t[:, model.tip]
        moved.append(float(np.abs(gap).max()))
    return moved[0] / moved[1]


def test_a_combination_of_links_that_no_pose_separates_moves_the_tip_in_no_pose(runs: dict[str, Path]) -> None:
    model = load(runs["moving"]).model
    assert isinstance(model, ExtendedChain)
    readings = np.random.default_rng(1).uniform(-2.0, 2.0, (50, 6))
    hidden = [
        group
        for group in _combinations(runs["moving"])
        if set(group["number_kind"]) <= {"link", "offset"} and set(group["remedy"]) == {"none"}
    ]
    assert len(hidden) >= 8
    # Sizes are printed with two digits, and lengths of links are known to first order.
    assert max(_tip_moves(model, group, readings) for group in hidden) < 0.02


def test_the_shift_along_parallel_axes_is_one_number_of_three_joints(runs: dict[str, Path]) -> None:
    pairs = [
        set(zip(group["subject"], group["parameter"], strict=True))
        for group in _combinations(runs["moving"])
        if len(group) == 2
    ]
    assert {("joint2", "dz"), ("joint3", "dz")} in pairs
    assert {("joint2", "dz"), ("joint4", "dz")} in pairs


def test_a_joint_that_stood_still_is_moved_by_the_pose_that_separates(runs: dict[str, Path]) -> None:
    shown = {name: [g for g in _combinations(run) if set(g["remedy"]) == {"poses"}] for name, run in runs.items()}
    assert not shown["moving"]
    assert shown["still"]
    for group in shown["still"]:
        pose = dict(part.rsplit(" ", 1) for part in group["separating_pose"].iloc[0].split("; "))
        value = next(float(v) for name, v in pose.items() if name.startswith("joint4_"))
        turn = np.radians(value) if "joint4_deg" in pose else value
        assert abs(turn - 0.4) > 0.05
    model = load(runs["still"]).model
    assert isinstance(model, ExtendedChain)
    own = [g for g in shown["still"] if set(g["number_kind"]) <= {"link", "offset"}]
    readings = np.random.default_rng(1).uniform(-2.0, 2.0, (50, 6))
    halted = readings * (np.arange(6) != STILL) + 0.4 * (np.arange(6) == STILL)
    for group in own:
        assert _tip_moves(model, group, halted) < 0.02
        assert _tip_moves(model, group, readings) > 0.05


def test_the_page_lists_only_combinations_with_a_number_that_is_not_determined(runs: dict[str, Path]) -> None:
    tables = {name: load(run) for name, run in runs.items()}
    for run in tables.values():
        numbers = run["chain_parameters"]
        listing = inseparable_listing(run["chain_inseparable"], numbers)
        assert listing is not None
        unknown = [f"{r.parameter} of {r.joint}" for r in numbers.itertuples() if not r.identifiable]
        assert all(any(name in row[0] for name in unknown) for row in listing.rows)
    first = inseparable_listing(tables["still"]["chain_inseparable"], tables["still"]["chain_parameters"])
    assert first is not None
    assert first.marks[0] == "warn"
    assert "joint4_" in first.rows[0][2]
    everything = inseparable_listing(
        tables["moving"]["chain_inseparable"], tables["moving"]["chain_parameters"].assign(identifiable=True)
    )
    assert everything is None
