"""`truing init` and `truing check` on column heads with units in many spellings, or unknown units."""

from __future__ import annotations

import difflib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.pipeline.test_init_exports import init, numbers, table
from tests.tolerance import assert_close
from truing.formats.raw_tables import SIGNALS
from truing.formats.units import UnknownUnit, conversion, known_unit
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode

POUND, INCH, GRAVITY = 4.4482216152605, 0.0254, 9.80665
LOADS = np.vstack([np.zeros((4, 6)), np.kron(np.eye(6), [[10.0], [20.0]])])
CHANNELS = (LOADS @ np.random.default_rng(5).normal(size=(6, 6)) * 1e-2).round(6)


def balance(folder: Path, force: str, torque: str, signal: str = "(mV/V)") -> None:
    """Write loads with these units behind their names, next to six bridges, below two lines of words."""
    heads = [f"F{axis}{force}" for axis in "xyz"] + [f"M{axis}{torque}" for axis in "xyz"]
    heads = ["Point", *heads, *(f"Ch{k} {signal}" for k in range(1, 7))]
    cells = [
        ",".join([str(k), *map(str, load), *map(str, read)])
        for k, (load, read) in enumerate(zip(LOADS, CHANNELS, strict=True), 1)
    ]
    text = ["Run ID,B-6 S/N 1" + "," * 11, "Date,5/21/2024" + "," * 11, ",".join(heads), *cells]
    (folder / "balance.csv").write_text("\n".join(text) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "newton_metres"),
    [
        *(
            (text, POUND * INCH)
            for text in ("lbf-in", "lbf·in", "lbf in", "in-lb", "in·lbf", "lb-in", "inlb", "LBF-IN")
        ),
        *((text, 12.0 * POUND * INCH) for text in ("ft-lb", "lbf·ft", "ft.lbs", "foot-pounds")),
        *((text, GRAVITY / 100.0) for text in ("kgf·cm", "kgf-cm", "kp cm", "kg·cm")),
        *((text, GRAVITY) for text in ("kgf-m", "kpm", "kgf*m")),
        *((text, 1e3) for text in ("kN·m", "kNm", "kN-m")),
        *((text, 1e-3) for text in ("Nmm", "N-mm", "N*mm", "N·mm", "mN·m", "mNm")),
        *((text, 1.0) for text in ("N m", "Nm", "N·m", "N-m", "N*m", "N.m", "N⋅m", "m·N")),
        *((text, POUND / 16.0 * INCH) for text in ("ozf·in", "oz-in", "ozf in")),
    ],
)
def test_every_spelling_of_a_unit_of_torque_has_its_factor(text: str, newton_metres: float) -> None:
    assert conversion(text, "N m") == (pytest.approx(newton_metres, rel=1e-12), 0.0)
    unit = known_unit(text)
    assert unit is not None
    assert conversion(unit, "N m")[0] == pytest.approx(newton_metres, rel=1e-12)


@pytest.mark.parametrize("text", ["nm", "mN", "min", "mm", "N/m", "foo", "lbf-furlong", "mil"])
def test_other_words_are_no_torques(text: str) -> None:
    unit = known_unit(text)
    assert unit is None or " " not in unit


def test_a_cell_of_a_table_that_is_no_unit_costs_no_search_for_similar_names(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each cell of an unknown table is asked: its message is for whoever reads it."""
    searches: list[str] = []
    search = difflib.get_close_matches
    monkeypatch.setattr(
        difflib, "get_close_matches", lambda word, *rest, **named: searches.append(word) or search(word, *rest, **named)
    )
    assert [known_unit(cell) for cell in ("-1234.5678", "CODE133", "2025-04-02", "mmm")] == [None] * 4
    assert searches == []
    with pytest.raises(UnknownUnit, match="did you mean mm"):
        conversion("mmm", "mm")
    assert searches == ["mmm"]


@pytest.mark.parametrize(
    ("force", "torque", "factors"),
    [
        (" (kgf)", " (lbf-in)", (GRAVITY, POUND * INCH)),
        (" [kp]", " [kgf·cm]", (GRAVITY, GRAVITY / 100.0)),
        ("_lbf", "_lbf_in", (POUND, POUND * INCH)),
        (" in N", " in N·mm", (1.0, 1e-3)),
        ("/kN", "/kN·m", (1e3, 1e3)),
    ],
)
def test_loads_in_units_of_their_heads_are_read_in_newtons(
    tmp_path: Path, force: str, torque: str, factors: tuple[float, float]
) -> None:
    balance(tmp_path, force, torque)
    text, document = init(tmp_path)
    found = table(tmp_path, document, SIGNALS)
    wanted = LOADS * np.repeat(factors, 3)
    assert_close(numbers(found, "fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"), wanted, atol=1e-8, what="loads")
    shown = [line.split() for line in text.splitlines() if line.startswith("1 ")]
    assert all(any(float(row[place]) for row in shown) for place in range(2, 8))


@pytest.mark.parametrize(("force", "torque"), [("(kg)", "(lbf-furlong)"), ("[klafter]", "[N]")])
def test_an_unknown_unit_is_asked_and_check_refuses_the_column(tmp_path: Path, force: str, torque: str) -> None:
    balance(tmp_path, f" {force}", f" {torque}")
    text, _ = init(tmp_path)
    starter = (tmp_path / "campaign.toml").read_text(encoding="utf-8")
    assert "no unit is given" not in starter
    assert "--answer unit_of_force=" in text
    assert "--answer unit_of_torque=" in text
    refused = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert refused.exit_code == ExitCode.UNUSABLE_CAMPAIGN
    assert "mx_nm" in refused.output + refused.stderr
    assert "fx_n" in refused.output + refused.stderr
    (tmp_path / "campaign.toml").unlink()
    answers = ["--answer", "unit_of_force=kgf", "--answer", "unit_of_torque=lbf-in"]
    assert CliRunner().invoke(app, ["init", str(tmp_path), *answers]).exit_code == ExitCode.DONE
    assert CliRunner().invoke(app, ["check", str(tmp_path)]).exit_code == ExitCode.DONE
    assert '"mx_nm" = "lbf-in"' in (tmp_path / "campaign.toml").read_text(encoding="utf-8")
