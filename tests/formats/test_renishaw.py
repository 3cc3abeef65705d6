"""Renishaw's positioning runs: every approach with target, direction and cycle, or a fault."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from tests.formats.reading import read, written
from tests.sentences import assert_says
from tests.tolerance import assert_close

TARGETS = [0.0, 25.0, 50.0, 75.0, 100.0, 125.0]
DEVIATIONS = np.random.default_rng(3).normal(0.0, 2.0, (4, len(TARGETS))).round(3)


def rtl(targets=TARGETS, end="\r\n", decimal="."):
    """A bidirectional test of two cycles: passes up and down in turn, five targets to a line."""
    rows = [" ".join(f"{t:.4f}" for t in targets[i : i + 5]) for i in range(0, len(targets), 5)]
    lines = ["HEADER::", "File type  : rtl", "Owner      : Linear", "", "TARGET DATA::", "Filetype  : ISO"]
    lines += [f"Target-count: {len(targets)}", "Targets :", *rows, "Flags: 0 0 2 0", "", "USER-TEXT::", "Axis: X", ""]
    lines += ["RUNS::", "Run-count: 4", "", "DEVIATIONS::", "Run Target Data:"]
    for number, deviations in enumerate(DEVIATIONS, start=1):
        order = range(len(targets)) if number % 2 else reversed(range(len(targets)))
        lines += [f"{number}   {k + 1}      {deviations[k]:.3f}" for k in order]
    lines += ["", "ENVIRONMENT::", "Air temp   : 20.1", "EOF::", ""]
    return end.join(lines).replace(".", decimal)


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("targets", [TARGETS, TARGETS[::-1]])
def test_every_approach_is_read(tmp_path, targets, decimal):
    written(tmp_path, "X axis.rtl", rtl(targets, decimal=decimal))
    found = read(tmp_path, "positioning", {"path": "*.rtl"})
    assert found.faults == ()
    assert set(found.columns["run"]) == {"X axis"}
    ups = ("forward", "backward") if targets == TARGETS else ("backward", "forward")
    expected = {(targets[k], ups[run % 2], run // 2 + 1): DEVIATIONS[run, k] for run in range(4) for k in range(6)}
    rows = {(row["target_mm"], row["direction"], row["cycle"]): row["position_mm"] for row in found.rows}
    assert rows.keys() == expected.keys()
    off = [1e3 * (rows[key] - key[0]) for key in expected]
    assert_close(off, list(expected.values()), atol=1e-9)


def test_compressed_and_under_another_name(tmp_path):
    (tmp_path / "x.rtl.gz").write_bytes(gzip.compress(rtl().encode()))
    written(tmp_path, "test.txt", rtl())
    assert len(read(tmp_path, "positioning", {"path": "x.rtl.gz"}).rows) == 24
    own = {"path": "test.txt", "format": "rtl", "constants": {"run": "mine"}}
    (fault,) = read(tmp_path, "positioning", {"path": "test.txt", "format": "rtl"}).faults
    assert_says(fault.expected, "name", "matches")
    assert set(read(tmp_path, "positioning", {**own, "from_name": "(?P<made>t)"}).columns["run"]) == {"mine"}


@pytest.mark.parametrize(
    ("old", "new", "expected", "value"),
    [
        ("TARGET DATA::", "TARGETS::", "the sections TARGET DATA:: and DEVIATIONS::", None),
        ("Target-count: 6", "Target-count: 7", "7 targets, as Target-count says", "6 targets"),
        ("25.0000", "25.00x0", "a number", "25.00x0"),
        ("\r\n2   6   ", "\r\n2   9   ", "a target from 1 to 6", "9"),
        ("\r\n2   6      ", "\r\n2   6   oops ", "three numbers: pass, target, deviation", None),
        ("\r\n3   2   ", "\r\n3   1   ", "follow each other upwards or downwards", "pass 3"),
        ("Targets :", "", "a list Targets :", None),
    ],
)
def test_a_damaged_rtl_file_is_a_fault(tmp_path, old, new, expected, value):
    assert old in rtl()
    written(tmp_path, "x.rtl", rtl().replace(old, new, 1))
    (fault,) = read(tmp_path, "positioning", {"path": "x.rtl"}).faults
    assert expected in fault.expected
    assert value is None or fault.value == value


@pytest.mark.parametrize("length", [0, 10, 200, 300])
def test_a_file_that_ends_early_is_a_fault(tmp_path, length):
    written(tmp_path, "x.rtl", rtl()[:length])
    assert len(read(tmp_path, "positioning", {"path": "x.rtl"}).faults) == 1
