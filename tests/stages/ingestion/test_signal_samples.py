"""Samples of a force sensor's signals: rows in succession with equal loads become one load step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.tolerance import assert_close
from truing.pipeline.in_memory import stage_line

HEAD = '[campaign]\nname = "s"\nkind = "interferometer"\n[noise]\nsignal_mv = 0.1\n'
LEVELS = (0.0, 100.0, 200.0, 100.0, 0.0)
COUNT = 7


def _rows(folder: Path, text: str, names: str, keys: str, *, averaged: bool = True) -> list[dict[str, float]]:
    switch = "[signals]\naverage_samples = true\n" if averaged else ""
    (folder / "campaign.toml").write_text(f'{HEAD}{switch}[files.signals]\npath = "*.csv"\n{keys}')
    if text:
        (folder / "log.csv").write_text(f"{names}\n{text}\n")
    return stage_line(folder).call("ingest").tables["signals"].to_pylist()


def _samples(seed: int = 5) -> np.ndarray:
    """Signals (levels, COUNT, 2) of each level."""
    rng = np.random.default_rng(seed)
    return np.array([rng.normal([level, -level], 1.0, (COUNT, 2)) for level in LEVELS])


def test_rows_in_succession_with_equal_loads_are_one_step(tmp_path: Path) -> None:
    signals = _samples()
    lines = [
        f"1,{load},{one[0]!r},{one[1]!r}".replace("np.float64(", "").replace(")", "")
        for load, of_level in zip(LEVELS, signals, strict=True)
        for one in of_level
    ]
    read = _rows(tmp_path, "\n".join(lines), "run,fz_n,v1_mv,v2_mv", "number_rows = { step = 1 }\n")
    assert [row["fz_n"] for row in read] == list(LEVELS)
    assert_close([[row["v1_mv"], row["v2_mv"]] for row in read], signals.mean(axis=1), atol=1e-9)


def test_equal_loads_of_two_numbered_steps_stay_two_steps(tmp_path: Path) -> None:
    text = "1,1,5,1.0\n1,1,5,3.0\n1,2,5,10.0\n1,2,5,20.0"
    read = _rows(tmp_path, text, "run,step,fz_n,v1_mv", "")
    assert [(row["step"], row["v1_mv"]) for row in read] == [(1, 2.0), (2, 15.0)]


def test_files_that_each_begin_with_step_1_are_not_mixed(tmp_path: Path) -> None:
    for name, load in (("a", 5.0), ("b", 9.0)):
        rows = "".join(f"{load},{load + sign}\n" for sign in (-1.0, 1.0))
        (tmp_path / f"{name}.csv").write_text(f"fz_n,v1_mv\n{rows}")
    keys = 'number_rows = { step = 1 }\nconstants = { run = "1" }\n'
    read = _rows(tmp_path, "", "", keys)
    assert [(row["fz_n"], row["v1_mv"]) for row in read] == [(5.0, 5.0), (9.0, 9.0)]
    assert len({row["step"] for row in read}) == 2


def test_without_the_key_every_row_is_a_step(tmp_path: Path) -> None:
    text = "1,1,5,1.0\n1,2,5,3.0"
    read = _rows(tmp_path, text, "run,step,fz_n,v1_mv", "", averaged=False)
    assert [row["v1_mv"] for row in read] == [1.0, 3.0]


@pytest.mark.parametrize("averaged", [True, False])
def test_means_do_not_show_that_no_single_sample_was_cut(tmp_path: Path, averaged: bool) -> None:
    text = "\n".join(f"1,{load},{load + k % 3}" for load in LEVELS for k in range(COUNT))
    _rows(tmp_path, text, "run,fz_n,v1_mv", "number_rows = { step = 1 }\n", averaged=averaged)
    line = stage_line(tmp_path)
    line.call("ingest")
    (found,) = [row for row in line.call("qa").tables["qa"].to_pylist() if row["check"] == "saturated"]
    assert found["verdict"] == "pass"
    assert ("single samples were not tested" in found["message"]) is averaged
