"""`truing init` on the log of a load cell: one force without an axis, sampled at each load."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.pipeline.test_init_exports import init, numbers, table
from tests.tolerance import assert_close
from truing.formats.raw_tables import SIGNALS
from truing.pipeline.command_line import app

LOADS_KN = (0.0, 2.0, 4.0, 2.0, 0.0)


def _log(folder: Path, head: str, samples: int) -> None:
    """A German log below lines of its program: decimal commas, times with milliseconds."""
    lines = ["Messprotokoll Kraftaufnehmer", "Messrate;2 Hz", f"Zeitstempel;{head};Kanal 1 [mV/V];Temperatur [°C]"]
    for load in LOADS_KN:
        for _ in range(samples):
            time = f"09.02.2024 09:14:{len(lines) // 2:02d},{500 * (len(lines) % 2):03d}"
            lines.append(f"{time};{load:.1f};{0.2 * load:.5f};21.05".replace(".", ",").replace(",02,2024", ".02.2024"))
    text = "\n".join(lines).replace("09,02.2024", "09.02.2024")
    (folder / "log.txt").write_text(text + "\n", encoding="cp1252")


@pytest.mark.parametrize("head", ["Sollkraft [kN]", "Force (kN)", "Prüflast [kN]", "reference force [kN]"])
def test_a_force_without_an_axis_is_a_load_whose_component_is_asked(tmp_path: Path, head: str) -> None:
    _log(tmp_path, head, 3)
    text, document = init(tmp_path)
    found = table(tmp_path, document, SIGNALS)
    assert_close(numbers(found, "load")[:, 0], np.repeat(LOADS_KN, 3), atol=1e-9, what="loads, in their unit")
    assert document["files"]["signals"]["units"]["load"] == "kN"  # stages convert it, by the axis
    assert_close(numbers(found, "v1_mv")[:, 0], 0.2 * np.repeat(LOADS_KN, 3), atol=1e-9, what="signals, mV")
    assert set(found.table.column("load_axis").to_pylist()) == {"fz"}
    assert "log.txt, Component of the load: taken as fz" in text
    assert 'load_axis = "fz" is a guess; no file names the component' in (tmp_path / "campaign.toml").read_text()


def test_the_answer_is_the_component(tmp_path: Path) -> None:
    _log(tmp_path, "Sollkraft [kN]", 3)
    done = CliRunner().invoke(app, ["init", str(tmp_path), "--answer", "load_axis=fx", "--answer", "run=a"])
    assert done.exit_code == 0, done.output
    assert "is a guess" not in (tmp_path / "campaign.toml").read_text()


@pytest.mark.parametrize(("samples", "are_samples"), [(3, False), (10, True)])
def test_many_rows_of_each_load_may_be_samples(tmp_path: Path, samples: int, are_samples: bool) -> None:
    """The first lines of the file end within a load."""
    _log(tmp_path, "Sollkraft [kN]", samples)
    init(tmp_path)
    assert ("average_samples = true" in (tmp_path / "campaign.toml").read_text()) == are_samples


def test_a_force_without_a_unit_or_without_a_channel_is_no_load(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("Force;Kanal 1 [mV/V]\n1.0;0.1\n2.0;0.2\n3.0;0.3\n")
    _, document = init(tmp_path)
    assert "files" not in document
