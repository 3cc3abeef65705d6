"""A force and a torque by two uneven units, in an overload test, by command line: the shares are recovered."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from tests.blind.generator.sensor.effects import LoadImbalance
from tests.blind.generator.sensor.layout import AXES
from tests.second_hand import eight_cells
from tests.second_hand.command import run
from truing.pipeline.command_line import app

ARM, PUSH, TURN = 0.55, 0.53, 0.52  # m; share of the first unit of a positive force and of a positive torque
UNITS = "\n[loading.units]\nfz = { arm_mm = [550.0, 0.0, 0.0] }\nmz = { arm_mm = [550.0, 0.0, 0.0] }\n"


# Statics of two units at +arm and -arm along x, per load. Shares s and 1 - s of a force F along z turn about y by
# -arm (2 s - 1) F. Forces +-f along y make a torque M = arm (f1 + f2) about z; shares s and 1 - s leave
# (2 s - 1) M / arm along y. When the load changes its sign, the other unit has the larger share.
TURNED, LEFT = -ARM * (2 * PUSH - 1), (2 * TURN - 1) / ARM


def _effects() -> list[LoadImbalance]:
    none = (0.0,) * 6
    force = LoadImbalance(AXES.index("fz"), none, (0.0, 0.0, 0.0, 0.0, 2 * TURNED, 0.0))
    return [force, LoadImbalance(AXES.index("mz"), none, (0.0, 2 * LEFT, 0.0, 0.0, 0.0, 0.0))]


def _folder(place: Path, overload: str) -> Path:
    """Loads to 9 kN and 4.5 kN m on a range of 7.5 kN and 3.75 kN m: 120 %."""
    drawn, _ = eight_cells.campaign(9, _effects(), signals=False)
    made = eight_cells.folder(place, drawn, UNITS)
    text = (made / "campaign.toml").read_text(encoding="utf-8")
    for load in AXES:
        old, new = ("_n = 10000.0", "_n = 7500.0") if load[0] == "f" else ("_nm = 5000.0", "_nm = 3750.0")
        assert load + old in text
        text = text.replace(load + old, load + new)
    (made / "campaign.toml").write_text(text.replace("[loading]\n", f"[loading]\n{overload}"), encoding="utf-8")
    return made


def test_a_load_beyond_the_range_is_refused_unless_the_overload_is_declared(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["check", str(_folder(tmp_path / "plain", ""))])
    assert done.exit_code == 2
    assert "overload" in done.output
    assert CliRunner().invoke(app, ["check", str(_folder(tmp_path / "said", "overload = 1.2\n"))]).exit_code == 0
    assert CliRunner().invoke(app, ["check", str(_folder(tmp_path / "less", "overload = 1.19\n"))]).exit_code == 2


def test_the_shares_of_both_loading_units_are_recovered(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "c", "overload = 1.2\n")
    found = run(folder, "diagnose", tmp_path / "run")["diagnosis"].query("verdict == 'found'").set_index("subject")
    assert set(found["cause"]) == {"load-imbalance"}
    assert set(found.index) == {"load fz", "load mz"}
    for subject, true in (
        ("load fz", {"share_asymmetry": 2 * PUSH - 1, "moment_y_asymmetry": 2 * TURNED}),
        ("load mz", {"share_asymmetry": 2 * TURN - 1, "force_y_asymmetry": 2 * LEFT}),
    ):
        reported = json.loads(found.loc[subject, "parameters"])
        assert set(reported) == set(true)
        for name, value in true.items():
            assert abs(reported[name]["value"] - value) < 4.0 * reported[name]["sigma"]
            assert 0.0 < reported[name]["sigma"] < 0.1 * abs(value)
    last = found.sort_values("rank").iloc[-1]
    assert 0.85 < last["rms_after"] / last["noise_floor"] < 1.15
