"""The benchmark of the whole pipeline runs at its smallest size."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from benchmarks.line import measure, table, write_bench
from tests.pipeline.test_sample_campaign import displacement_campaign
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.stage_order import order_of


@pytest.mark.slow
def test_every_stage_is_timed_and_none_is_counted_twice(tmp_path: Path) -> None:
    folder = tmp_path / "bench"
    displacement_campaign(folder)
    line = measure(folder, tmp_path / "run")
    assert tuple(line.stages) == order_of(open_campaign(folder).kind, photographs=False)
    assert all(seconds > 0.0 for seconds in line.stages.values())
    assert sum(line.stages.values()) < line.processor_s
    assert 50e6 < line.memory < 8e9, "bytes of a process that has loaded numpy and pyarrow"
    words = table({"bench": line}).splitlines()
    assert len(words) == 1 + len(line.stages) + 3
    assert "diagnose, CPU s" in words[5]


def test_the_bench_is_as_long_as_it_says(tmp_path: Path) -> None:
    folder = write_bench(tmp_path / "bench", repeats=2)
    with (folder / "signals.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 2 * 756
