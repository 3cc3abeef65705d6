"""The tutorial's steps work in order, and its page shows their current output."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.conftest import PROJECT
from truing.pipeline.command_line import app

PAGE = (PROJECT / "docs" / "tutorial.md").read_text(encoding="utf-8")
NUMBER = re.compile(r"\d[\d,.]*")
EXCLUDED = "reflection on the tube"


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)```", PAGE, re.MULTILINE | re.DOTALL)


def called(*words: str):
    return CliRunner().invoke(app, list(words))


def skeletons(text: str) -> list[str]:
    """Lines without their numbers, as fewer poses than on the page are read here."""
    return [" ".join(NUMBER.sub("#", line).replace("-#", "#").split()) for line in text.strip().splitlines()]


@pytest.fixture
def place(workplace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Step 1 in a folder next to the sample, cut short."""
    (tmp_path / "sample_data").symlink_to(workplace / "sample_data")
    monkeypatch.chdir(tmp_path)
    (program,) = blocks("python")
    exec(program, {})
    return tmp_path


def test_the_commands_are_those_that_are_walked():
    reported = [line for block in blocks("sh") for line in block.splitlines()]
    assert reported == [
        *(f"truing {word} my-lab" for word in ("init", "check", "run", "stages", "run")),
        "truing design my-lab --poses 40 --out next.csv",
        "truing power my-lab --draws 0",
        "truing export runs/my-lab",
    ]


def test_every_step_says_what_the_page_shows(place: Path):
    """Stages up to the deformation: what comes after them is run by others, and takes its time."""
    _, init, check, fault, run = blocks("text")
    output = called("init", "my-lab")
    assert skeletons(output.stdout) == skeletons(init)
    assert (place / "my-lab" / "campaign.toml").is_file()
    untouched = called("check", "my-lab")  # what was guessed can be read as it is, and is not complete
    assert (untouched.exit_code, len(untouched.stderr.splitlines())) == (2, 1), untouched.stderr
    assert "key noise.point_mm" in untouched.stderr

    toml, exclusion = blocks("toml")
    campaign = place / "my-lab" / "campaign.toml"
    campaign.write_text(toml.replace('decimal = ","\n', ""), encoding="utf-8")
    assert fault.strip() in called("check", "my-lab").stderr.splitlines()
    campaign.write_text(toml, encoding="utf-8")
    assert skeletons(called("check", "my-lab").stdout) == skeletons(check)

    done = called("run", "my-lab", "--only", "deformation")
    assert done.exit_code == 0, done.output
    stages = [line for line in done.stdout.splitlines() if line.split()[0] in ("ingest", "pose", "deformation")]
    assert [line.split(";")[0].split()[:3:2] for line in stages] == [
        [name, "read"] for name in ("ingest", "pose", "deformation")
    ]
    assert skeletons(stages[0])[0] in skeletons(run)

    campaign.write_text(f"{toml}\n{exclusion}".replace("pose = 23", "pose = 3"), encoding="utf-8")
    reported = called("stages", "my-lab").stdout
    assert re.search(r"^ingest +stale", reported, re.MULTILINE) or re.search(r"^pose +stale", reported, re.MULTILINE)
    again = called("run", "my-lab", "--only", "pose")
    assert again.exit_code == 0
    assert EXCLUDED in again.stdout

    design = called("design", "my-lab", "--poses", "40", "--out", "next.csv")
    assert design.exit_code == 0, design.output
    assert len((place / "next.csv").read_text(encoding="utf-8").splitlines()) == 1 + 41  # header, reference, 40 poses
