"""`truing init` joins commands of an axis and readings of another file, and asks how their rows belong together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.pipeline.test_init_exports import init
from tests.tolerance import assert_close
from truing.pipeline.campaign_check import check_campaign
from truing.pipeline.campaign_folder import open_campaign
from truing.pipeline.command_line import app

AT = np.array([*np.arange(0.0, 361.0, 30.0), *np.arange(360.0, -1.0, -30.0)])
OFF = np.round(2.4 * np.sin(np.radians(2.0 * AT)) + 0.1, 2)  # arc seconds


def _write(folder: Path, command: str, keys: tuple[str, ...], second: slice = slice(None)) -> None:
    """Two files: commands with the cells of a form, and readings of an autocollimator; either with these keys."""
    cells = {"Nr": [str(1 + k) for k in range(len(AT))], "Time": [f"{60 * k}.5" for k in range(len(AT))]}
    for name, heads, values in (
        (
            "commands.csv",
            ["Position" + (" [deg]" if "°" not in command else ""), "Temp [°C]"],
            [*zip(AT, 20.0 + AT / 1e3, strict=True)],
        ),
        ("akf.csv", ["X [arcsec]", "Y [arcsec]"], [*zip(OFF, OFF[::-1], strict=True)][second]),
    ):
        rows = range(len(AT))[second if name == "akf.csv" else slice(None)]
        form = [command if name == "commands.csv" else "{:.2f}", "{:.3f}"]
        lines = [
            ";".join([*(cells[key][row] for key in keys), *(f.format(v) for f, v in zip(form, pair, strict=True))])
            for row, pair in zip(rows, values, strict=True)
        ]
        (folder / name).write_text("\n".join([";".join([*keys, *heads]), *lines]) + "\n", encoding="utf-8")


def _errors(folder: Path) -> np.ndarray:
    """Measured place minus command, arc seconds, as `truing check` reads the campaign."""
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    text = text.replace("# measured_deg = 0.001", "measured_deg = 0.001")
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    tables = check_campaign(open_campaign(folder)).ingested
    assert tables is not None
    found = tables["configurations"].to_pandas()
    return np.column_stack([found["command_deg"], 3600.0 * (found["measured_deg"] - found["command_deg"])])


@pytest.mark.parametrize("command", ["{:.1f}", "{:03.0f}°00'00.0\""])
@pytest.mark.parametrize(("keys", "way"), [(("Nr",), "pose"), ((), "rows"), (("Nr", "Time"), "pose")])
def test_commands_and_readings_of_an_axis_are_joined(
    tmp_path: Path, command: str, keys: tuple[str, ...], way: str
) -> None:
    _write(tmp_path, command, keys)
    _, document = init(tmp_path)
    assert (document["files"]["measured"]["path"], document["files"]["measured"]["joined_by"]) == ("akf.csv", way)
    assert document["mechanism"]["type"] == "axis"
    assert_close(_errors(tmp_path), np.column_stack([AT, OFF]), atol=1e-6, what="errors")


def test_fewer_readings_are_joined_by_time(tmp_path: Path) -> None:
    _write(tmp_path, "{:.1f}", ("Time",), slice(None, None, 2))
    assert init(tmp_path)[1]["files"]["measured"]["joined_by"] == "time"
    assert_close(_errors(tmp_path), np.column_stack([AT, OFF])[::2], atol=1e-6, what="errors")


def test_nothing_is_joined_without_a_key(tmp_path: Path) -> None:
    _write(tmp_path, "{:.1f}", (), slice(None, None, 2))
    assert "measured" not in init(tmp_path)[1].get("files", {})


def test_answers_turn_the_sign_and_join_by_order(tmp_path: Path) -> None:
    _write(tmp_path, "{:.1f}", ("Nr",))
    answers = ["--answer", "sign=command-place", "--answer", "join=rows"]
    done = CliRunner().invoke(app, ["init", str(tmp_path), *answers])
    assert done.exit_code == 0, done.stdout
    assert 'joined_by = "rows"' in (tmp_path / "campaign.toml").read_text(encoding="utf-8")
    assert_close(_errors(tmp_path), np.column_stack([AT, -OFF]), atol=1e-6, what="errors")
