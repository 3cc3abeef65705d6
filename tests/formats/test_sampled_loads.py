"""Recordings of a force sensor: rows that repeat a load are proposed as samples, load steps are not."""

from __future__ import annotations

from pathlib import Path

import pytest

from truing.formats.sniff import sniff_file


@pytest.mark.parametrize(("per_load", "asks"), [(20, True), (1, False)])
def test_rows_that_repeat_a_load_raise_the_question_of_samples(tmp_path: Path, per_load: int, asks: bool) -> None:
    loads = [load for load in range(0, 200, 10 * per_load) for _ in range(per_load)]
    rows = "".join(f"{load},0,0,0,0,0,{0.1 * load + 0.01 * k},{k % 3}\n" for k, load in enumerate(loads))
    file = tmp_path / "log.csv"
    file.write_text(f"Fx,Fy,Fz,Mx,My,Mz,s0,s1\n{rows}")
    guess = sniff_file(file)
    assert guess.table == "signals"
    assert any("average_samples" in doubt for doubt in guess.doubts) is asks


@pytest.mark.parametrize(("name", "per_run"), [("Run", 7), ("Lauf-Nr", 7), ("Serie", 7), ("Run", 1)])
def test_a_column_of_runs_is_read_and_one_that_counts_rows_is_not(tmp_path: Path, name: str, per_run: int) -> None:
    rows = "".join(f"{1 + k // per_run},{k},{10 * (k % 7)},0,0,0,0,0,{0.1 * k:.3f},{k % 3}\n" for k in range(42))
    file = tmp_path / "log.csv"
    file.write_text(f"{name},No,Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm],Ch1 [mV/V],Ch2 [mV/V]\n{rows}")
    guess = sniff_file(file)
    assert guess.table == "signals"
    if per_run > 1:
        assert guess.mapping["columns"]["run"] == name
        assert "run" not in guess.mapping.get("constants", {})
    else:
        assert guess.mapping["constants"] == {"run": "1"}
