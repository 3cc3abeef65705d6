"""Odd but valid campaigns give the same results, without any message."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tests.broken.good import telescope
from truing.pipeline.command_line import app
from truing.pipeline.problems import ExitCode

Odd = Callable[[Path], Path]


def _moved(name: str) -> Odd:
    return lambda campaign: campaign.rename(campaign.with_name(name))


def _linked(campaign: Path) -> Path:
    real = campaign.rename(campaign.with_name("elsewhere"))
    campaign.symlink_to(real, target_is_directory=True)
    return campaign


def _linked_file(campaign: Path) -> Path:
    (campaign / "points.csv").rename(campaign.with_name("export of the day.csv"))
    (campaign / "points.csv").symlink_to(campaign.with_name("export of the day.csv"))
    return campaign


def _rewritten(change: Callable[[str], bytes]) -> Odd:
    def odd(campaign: Path) -> Path:
        for path in campaign.glob("*.csv"):
            path.write_bytes(change(path.read_text(encoding="utf-8")))
        return campaign

    return odd


def _turned(campaign: Path) -> Path:
    """Rows in another order: nothing says that poses or targets come one after the other."""
    head, *rows = (campaign / "configurations.csv").read_text().splitlines()
    (campaign / "configurations.csv").write_text("\n".join([head, *rows[::-1]]) + "\n")
    return campaign


CASES: dict[str, Odd] = {
    "blanks and umlauts": _moved("Meßreihe Nr. 3 – übermäßig lang, (Kopie)"),
    "quotes and a dollar": _moved('it\'s $HOME & "more"') if sys.platform != "win32" else _moved("it's $HOME"),
    "a linked folder": _linked,
    "a linked file": _linked_file,
    "line ends of Windows": _rewritten(lambda text: text.replace("\n", "\r\n").encode()),
    "a byte order mark": _rewritten(lambda text: text.encode("utf-8-sig")),
    "UTF-16": _rewritten(lambda text: text.encode("utf-16")),
    "no last line end": _rewritten(lambda text: text.rstrip("\n").encode()),
    "blank lines at the end": _rewritten(lambda text: (text + "\n\n").encode()),
    "poses in another order": _turned,
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("plain")
    _run(telescope(place / "campaign"), place / "run")
    return place / "run"


def _run(campaign: Path, out: Path) -> None:
    done = CliRunner().invoke(app, ["run", str(campaign), "--out", str(out), "--quiet", "--only", "qa"])
    assert (done.exit_code, done.output) == (ExitCode.DONE, "")


@pytest.mark.skipif(os.name == "nt", reason="links need a privilege there, and names may not hold quotes")
@pytest.mark.parametrize("name", CASES)
def test_odd_spellings_give_the_tables_of_the_plain_campaign(name: str, plain: Path, tmp_path: Path) -> None:
    _run(CASES[name](telescope(tmp_path / "campaign")), tmp_path / "run")
    for file in ("observations.parquet", "qa.parquet"):
        assert pq.read_table(tmp_path / "run" / file).equals(pq.read_table(plain / file)), file
