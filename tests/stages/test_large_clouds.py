"""The benchmark of large clouds runs at its smallest size, and no stage holds a number for every pair of poses."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from benchmarks.clouds import SMALLEST, STAGES, compare, make_campaign
from truing.estimation.quality import find_drift
from truing.estimation.rigid_poses.procrustes import common_shape
from truing.pipeline.in_memory import stage_line


@pytest.mark.parametrize("survey", [True, False])
def test_the_benchmark_runs_every_stage_on_every_point(
    survey: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    smallest = int(SMALLEST[-1])
    sizes = [smallest, 3 * smallest] if survey else [smallest]
    costs = compare(tmp_path, sizes, survey=survey)
    assert [(cost.stage, cost.points) for cost in costs] == [(stage, size) for size in sizes for stage in STAGES]
    assert all(cost.cpu > 0.0 and cost.peak > 1.0 for cost in costs)
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(costs)


def test_gross_errors_are_found_and_poses_fit(tmp_path: Path) -> None:
    points = make_campaign(tmp_path, 3000)
    found = stage_line(tmp_path).call("ingest", "qa", "pose").tables
    rejected = found["residuals"].column("rejected").to_pylist()
    assert 1 <= sum(rejected) <= 0.006 * points
    assert set(found["poses"].column("status").to_pylist()) == {"ok"}


@pytest.mark.parametrize("what", ["drift", "shape"])
def test_memory_grows_with_the_poses_and_not_with_their_square(what: str) -> None:
    """Four times as many poses take four times the memory; a number per pair of poses would take sixteen times."""
    rng = np.random.default_rng(1)
    shape = rng.uniform(-0.2, 0.2, (6, 3))

    def peak(poses: int) -> int:
        points, is_observed = shape + 5e-6 * rng.normal(size=(poses, 6, 3)), np.ones((poses, 6), bool)
        tracemalloc.start()
        try:
            _ = find_drift(points, is_observed) if what == "drift" else common_shape(points, is_observed, 5e-6)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(1000)
    assert peak(8000) < 6.0 * peak(2000)
