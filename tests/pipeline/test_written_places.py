"""Output of a command never replaces a raw file, a table of a run, or an input of the command."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from truing.pipeline.command_line import app


def call(*words: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, list(map(str, words)))
    assert "Traceback" not in done.output
    return done.exit_code, done.output


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def place(workplace: Path, tmp_path: Path) -> Path:
    """A campaign, and the run of it."""
    shutil.copytree(workplace / "sample_data" / "telescope", tmp_path / "campaign")
    shutil.copytree(workplace / "runs" / "telescope", tmp_path / "run")
    return tmp_path


REFUSED = {
    "design onto the configurations": "design {c} --poses 8 --out {c}/configurations.csv",
    "design onto a table beside campaign.toml": "design {c} --poses 8 --out {c}/points.csv",
    "design onto what it extends": "design {c} --poses 8 --extend {p}/more.csv --out {p}/more.csv",
    "design onto a folder": "design {c} --poses 8 --out {p}/folder.csv",
    "predict onto its inputs": "predict {r}/model.toml {p}/more.csv --out {p}/more.csv",
    "predict onto raw files": "predict {r}/model.toml {p}/more.csv --out {c}/configurations.csv",
    "predict onto a table of a run": "predict {r}/model.toml {p}/more.csv --out {r}/poses.parquet",
    "power onto raw files": "power {c} --draws 0 --causes actuator-gain --out {c}/points.csv",
    "export among raw files": "export {r} --to csv --out {c}",
    "compare among raw files": "compare {r} {p}/second --out {c}",
}


@pytest.mark.parametrize("name", REFUSED)
def test_inputs_raw_files_and_runs_are_not_overwritten(name: str, place: Path) -> None:
    shutil.copy(place / "campaign" / "configurations.csv", place / "more.csv")
    (place / "folder.csv").mkdir()
    if "second" in REFUSED[name]:
        shutil.copytree(place / "run", place / "second")
    before = contents(place)
    words = [word.format(c=place / "campaign", r=place / "run", p=place) for word in REFUSED[name].split()]
    code, output = call(*words)
    assert code == 2, output
    assert contents(place) == before
    assert output.startswith("--out: found ")


def test_a_file_of_ones_own_is_written_again(place: Path) -> None:
    for _ in range(2):
        assert (
            call(
                "predict",
                place / "run" / "model.toml",
                place / "campaign" / "configurations.csv",
                "--out",
                place / "p.csv",
            )[0]
            == 0
        )
    for _ in range(2):
        code, output = call("export", place / "run", "--to", "csv", "--out", place / "tables", "--json")
        assert code == 0
    reported = json.loads(output)["files"]
    assert {row["form"] for row in reported} == {"csv"}
    assert {Path(row["file"]) for row in reported} == set((place / "tables").iterdir())
