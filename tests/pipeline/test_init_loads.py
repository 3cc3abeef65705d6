"""`truing init` reads equal loads once, and `truing check` counts load steps without signals."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.pipeline.test_init_exports import init
from tests.sentences import assert_says
from tests.stages.line import run_line
from truing.formats.raw_tables import WRENCH
from truing.pipeline.campaign_check import check_campaign
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.command_line import app

LOADS = np.vstack([np.zeros((2, 6)), np.kron(np.eye(6), [[10.0], [-10.0]])])
SIGNALS = (LOADS @ np.random.default_rng(2).normal(size=(6, 6)) * 1e-2).round(6)
COMPONENTS = ["Fx [N]", "Fy [N]", "Fz [N]", "Mx [N m]", "My [N m]", "Mz [N m]"]
CHANNELS = [f"CH{k} [mV/V]" for k in range(1, 7)]


def text(names: list[str], values: np.ndarray) -> str:
    rows = [",".join([str(step), *(f"{value:g}" for value in row)]) for step, row in enumerate(values, 1)]
    return "\n".join([",".join(["Step", *names]), *rows]) + "\n"


@pytest.mark.parametrize(("plan", "both"), [("a_loads.csv", "b_merged.csv"), ("b_loads.csv", "a_merged.csv")])
def test_a_file_of_loads_is_left_out_next_to_the_same_loads_with_signals(tmp_path: Path, plan: str, both: str) -> None:
    (tmp_path / plan).write_text(text(COMPONENTS, LOADS))
    (tmp_path / both).write_text(text(COMPONENTS + CHANNELS, np.hstack([LOADS, SIGNALS])))
    shown, document = init(tmp_path)
    assert document["files"]["signals"]["path"] == both
    assert f"{plan}: not read, because {both} holds the same {len(LOADS)} loads" in shown


def test_the_same_loads_in_another_order_are_read_once(tmp_path: Path) -> None:
    mixed = LOADS[np.random.default_rng(4).permutation(len(LOADS))] * (1.0 + 1e-8)
    (tmp_path / "plan.csv").write_text(text(COMPONENTS, mixed))
    (tmp_path / "both.csv").write_text(text(COMPONENTS + CHANNELS, np.hstack([LOADS, SIGNALS])))
    assert init(tmp_path)[1]["files"]["signals"]["path"] == "both.csv"


def test_other_loads_of_the_same_number_are_read(tmp_path: Path) -> None:
    (tmp_path / "plan.csv").write_text(text(COMPONENTS, np.vstack([LOADS[:-1], 2.0 * LOADS[-1:]])))
    (tmp_path / "both.csv").write_text(text(COMPONENTS + CHANNELS, np.hstack([LOADS, SIGNALS])))
    entries = init(tmp_path)[1]["files"]["signals"]
    assert {entry["path"] for entry in entries} == {"plan.csv", "both.csv"}


def test_two_runs_with_the_same_loads_and_signals_of_their_own_are_both_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    for name in ("first.csv", "second.csv"):
        own = np.hstack([LOADS, SIGNALS + rng.normal(0.0, 1e-3, SIGNALS.shape).round(6)])
        (tmp_path / name).write_text(text(COMPONENTS + CHANNELS, own))
    entries = init(tmp_path)[1]["files"]["signals"]
    entries = entries if isinstance(entries, list) else [entries]
    assert "first.csv" in str(entries) or "*.csv" in str(entries)
    assert len(check_campaign(open_campaign(tmp_path)).ingested["signals"]) == 2 * len(LOADS)  # type: ignore[index]


def campaign(folder: Path, *, with_plan: bool) -> Path:
    """A campaign of loads with signals, and (``with_plan``) of the same loads without signals as a second run."""
    folder.mkdir()
    (folder / "plan.csv").write_text(text(COMPONENTS, LOADS))
    (folder / "both.csv").write_text(text(COMPONENTS + CHANNELS, np.hstack([LOADS, SIGNALS])))
    keys = ", ".join(f'{key} = "{name}"' for key, name in zip(WRENCH, COMPONENTS, strict=True))
    more = ", ".join(f'v{k}_mv = "{name}"' for k, name in enumerate(CHANNELS, 1))
    units = ", ".join(f'v{k}_mv = "mV/V"' for k in range(1, 7))
    entry = '[[files.signals]]\npath = "{}"\nconstants = {{ run = "{}" }}\ncolumns = {{ step = "Step", {} }}\n'
    toml = '[campaign]\nname = "c"\nkind = "interferometer"\n[noise]\nsignal_mv = 0.001\n'
    toml += entry.format("both.csv", 1, f"{keys}, {more}") + f"units = {{ {units} }}\n"
    toml += entry.format("plan.csv", 2, keys) if with_plan else ""
    (folder / "campaign.toml").write_text(toml)
    return folder


def test_load_steps_without_any_signal_are_counted_by_check_and_qa(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "double", with_plan=True)
    qa = run_line(folder, "ingest", "qa")[0]["qa"].to_pandas().set_index("check")
    row = qa.loc["steps-without-signals"]
    assert (row["value"], row["verdict"]) == (len(LOADS), "warn")
    assert_says(row["message"], f"{len(LOADS)} of {2 * len(LOADS)} load steps", "no signal")
    reported = check_campaign(open_campaign(folder)).attention
    assert_says(reported, f"{len(LOADS)} of {2 * len(LOADS)} load steps have no signal")


def test_load_steps_that_all_have_signals_pass(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "single", with_plan=False)
    qa = run_line(folder, "ingest", "qa")[0]["qa"].to_pandas().set_index("check")
    assert qa.loc["steps-without-signals", "verdict"] == "pass"
    assert not any("no signal" in one for one in check_campaign(open_campaign(folder)).attention)


def test_forces_without_a_unit_are_asked_and_read_by_the_answer(tmp_path: Path) -> None:
    """Weights in gram-force next to raw counts: newtons are a guess."""
    rows = [",".join(map(str, (151 * (k % 3), 151 * (k % 2), 0, 1000 + k, 2000 - k, 3000))) for k in range(9)]
    (tmp_path / "cell.csv").write_text("\n".join(["force_x,force_y,force_z,sensor_x,sensor_y,sensor_z", *rows, ""]))
    done = CliRunner().invoke(app, ["init", str(tmp_path), "--answer", "unit_of_force=gf"])
    assert done.exit_code == 0, done.output
    units = tomllib.loads((tmp_path / "campaign.toml").read_text())["files"]["signals"]["units"]
    assert units == dict.fromkeys(("fx_n", "fy_n", "fz_n"), "gf")
    (tmp_path / "campaign.toml").unlink()
    open_points = CliRunner().invoke(app, ["init", str(tmp_path)]).output
    assert "Unit of force_x, force_y, force_z, which the file does not give: taken as N" in open_points
