"""Questions of `truing init`, its answers, and the rows that it shows."""

from __future__ import annotations

import json
import os
import re
import shlex
import sys
import threading
import tomllib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from typer.testing import CliRunner

from truing.formats.guess import Guess
from truing.pipeline.campaign_template import MARK, assumed_unit
from truing.pipeline.command_line import app
from truing.pipeline.console import RunConsole
from truing.pipeline.init_campaign import init_campaign
from truing.pipeline.init_questions import Question, parsed_answers
from truing.schemas.campaign import read_campaign

COMMAS = "Punkt;X;Y;Z\nP1;1,234;12,345;100,001\nP2;2,234;13,345;200,001\nP3;3,234;15,345;300,001\n"
ANGLES = "X,Y,Z,RX,RY,RZ\n100.5,0.6,0.7,1.1,0.2,0.3\n100.4,0.6,0.7,1,0,0.1\n100.3,0.6,0.7,1,0.4,0\n"
NAMED = "body,target,x_mm,y_mm,z_mm\nbase,P1,1.5,2.5,3.5\nbase,P2,4.5,5.5,6.5\nbase,P3,7.5,8.5,9.75\n"


def init(folder: Path, *answers: str) -> Result:
    words = [word for answer in answers for word in ("--answer", answer)]
    return CliRunner().invoke(app, ["init", str(folder), *words])


def written(folder: Path) -> dict[str, Any]:
    document = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
    read_campaign(document)
    return document


def shown(output: str) -> list[list[str]]:
    """Words of the lines below the last line of a file or of answers."""
    lines = output.splitlines()
    first = max(i for i, line in enumerate(lines) if line.startswith(("list.csv:", "by these answers")))
    return [line.split() for line in lines[first + 1 :] if not line.startswith(("wrote", "the same"))]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "list.csv").write_text(COMMAS)
    return tmp_path


def answering(answers: dict[str, str | None], asked: list[str]) -> Callable[[Question], str | None]:
    def ask(question: Question) -> str | None:
        asked.append(question.key)
        return answers.get(question.key, question.taken or None)

    return ask


def test_a_comma_before_three_digits_everywhere_is_asked_and_each_answer_reads_its_numbers(folder: Path) -> None:
    for decimal, first in ((",", ["base", "P1", "1.234", "12.345", "100.001"]), (".", ["base", "P1", "1234", "12345"])):
        done = init(folder, f"decimal={decimal}", "body=base", "unit=mm")
        assert done.exit_code == 0, done.output
        assert shown(done.output)[0] == ["body", "target", "x_mm", "y_mm", "z_mm"]
        assert shown(done.output)[1][: len(first)] == first
        entry = written(folder)["files"]["targets"]
        assert (entry.get("decimal"), entry.get("thousands")) == ((",", None) if decimal == "," else (None, ","))
        (folder / "campaign.toml").unlink()


@pytest.mark.parametrize("cell", ["0,234", "1,23", "1234,567", "-0,001"])
def test_one_number_that_no_separator_of_thousands_writes_leaves_nothing_to_ask(folder: Path, cell: str) -> None:
    (folder / "list.csv").write_text(f"{COMMAS}P4;{cell};1,5;1,5\n")
    asked: list[str] = []
    init_campaign(folder, RunConsole(quiet=False), ask=answering({}, asked))
    assert asked == ["table", "unit", "body"]
    assert written(folder)["files"]["targets"]["decimal"] == ","


def test_a_file_that_names_everything_has_no_question(folder: Path) -> None:
    (folder / "list.csv").unlink()
    (folder / "targets.csv").write_text(NAMED)
    asked: list[str] = []
    init_campaign(folder, RunConsole(quiet=False), ask=answering({}, asked))
    assert asked == []


def test_an_answer_is_no_guess_any_more_and_its_unit_scales_the_rows(folder: Path) -> None:
    done = init(folder, "unit=m", "body=stage", "decimal=,")
    assert done.exit_code == 0
    assert shown(done.output)[1] == ["stage", "P1", "1234", "12345", "100001"]
    text = (folder / "campaign.toml").read_text()
    assert MARK not in text
    assert written(folder)["files"]["targets"]["unit"] == "m"
    assert written(folder)["files"]["targets"]["constants"] == {"body": "stage"}


def test_a_list_can_be_the_points_of_one_pose(folder: Path) -> None:
    done = init(folder, "table=points", "pose=7", "body=stage")
    assert done.exit_code == 0, done.output
    assert written(folder)["files"]["points"]["constants"] == {"pose": 7, "body": "stage"}
    assert MARK in (folder / "campaign.toml").read_text()  # the unit is still a guess


def test_three_angles_can_be_euler_angles(folder: Path) -> None:
    (folder / "list.csv").write_text(ANGLES)
    done = init(folder, "rotation=euler", "unit=mm", "body=tool")
    assert done.exit_code == 0, done.output
    head, row = shown(done.output)[:2]
    assert float(row[head.index("euler_a_deg")]) == pytest.approx(63.0253575, abs=1e-6)  # 1.1 rad
    assert "needed: the order" in (folder / "campaign.toml").read_text()


def test_the_order_of_euler_angles_is_asked_and_written(folder: Path) -> None:
    (folder / "list.csv").write_text(ANGLES)
    done = init(folder, "rotation=euler", "unit=mm", "body=tool", "euler=ZYX")
    assert done.exit_code == 0, done.output
    assert tomllib.loads((folder / "campaign.toml").read_text())["poses"] == {"euler": "ZYX"}


def test_an_order_about_the_same_axis_twice_is_no_answer(folder: Path) -> None:
    (folder / "list.csv").write_text(ANGLES)
    assert init(folder, "rotation=euler", "euler=XXZ").exit_code == 2
    assert not (folder / "campaign.toml").exists()


def test_every_answer_of_the_documentation_is_known() -> None:
    rows = re.findall(r"^\| (`.+?) \|", (Path(__file__).parents[2] / "docs/own-files.md").read_text(), re.MULTILINE)
    answers = [answer for row in rows for answer in re.findall(r"`(\w+=[^`]+)`", row)]
    assert len(answers) > 20
    for answer in answers:
        parsed_answers([answer])  # raises for a key that answers no question


def test_the_last_line_repeats_the_same_answers(folder: Path) -> None:
    init_campaign(
        folder, RunConsole(quiet=False), ask=answering({"body": "my stage", "unit": "in", "decimal": "."}, [])
    )
    first = (folder / "campaign.toml").read_bytes()
    (folder / "campaign.toml").unlink()
    done = init(folder, "decimal=.", "table=targets", "unit=in", "body=my stage")
    assert (folder / "campaign.toml").read_bytes() == first
    (folder / "campaign.toml").unlink()
    command = re.search(r"^the same answers again: truing (.*)$", done.output, re.MULTILINE)
    assert command is not None
    assert CliRunner().invoke(app, shlex.split(command[1])).exit_code == 0
    assert (folder / "campaign.toml").read_bytes() == first


def test_nobody_is_asked_without_a_terminal(folder: Path) -> None:
    done = CliRunner().invoke(app, ["init", str(folder)], input="m\n" * 9)
    assert done.exit_code == 0
    open_points = [line for line in done.output.splitlines() if line.startswith("open: list.csv, ")]
    assert any("Unit of the coordinates" in line and ": taken as mm (else:" in line for line in open_points)
    assert "the same answers" not in done.output
    assert MARK in (folder / "campaign.toml").read_text()
    assert "unit" not in written(folder)["files"]["targets"]


def test_all_invalid_answers_are_reported_and_nothing_is_written(folder: Path) -> None:
    done = init(folder, "unit=parsec", "decimal=;", "coverage=2", "other.csv:body=x")
    assert done.exit_code == 2
    faults = [line for line in done.stderr.splitlines() if line.startswith("--answer: found")]
    assert len(faults) == 4
    for answer in ("unit=parsec", "decimal=;", "coverage=2", "other.csv:body=x"):
        assert any(f"'{answer}'" in line for line in faults)
    assert not (folder / "campaign.toml").exists()
    done = init(folder, "bodi=x", "unit")
    assert done.exit_code == 2
    assert "did you mean body" in done.stderr
    assert "'unit'" in done.stderr


def test_an_answer_for_one_file_goes_before_that_for_all(folder: Path) -> None:
    (folder / "other.csv").write_text(COMMAS)
    done = init(folder, "unit=m", "other.csv:unit=mm")
    assert done.exit_code == 0, done.output
    entries = {entry["path"]: entry for entry in written(folder)["files"]["targets"]}
    assert (entries["list.csv"]["unit"], entries["other.csv"]["unit"]) == ("m", "mm")


def _press_until_it_ends(terminal: int, key: bytes) -> None:
    """Press a key again and again: Python loses a signal between the prompt and the read."""
    with suppress(OSError):  # nobody is left at the other end
        while True:
            threading.Event().wait(0.5)  # other tests replace time.sleep
            os.write(terminal, key)
    os.close(terminal)


@pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
@pytest.mark.parametrize(("typed", "code"), [(b",\n\nparsec\nm\n\n", 0), (b"\x03", 130)])
def test_a_terminal_is_asked_until_the_answer_is_valid_and_ctrl_c_writes_nothing(
    folder: Path, typed: bytes, code: int
) -> None:
    import pty

    output = b""

    def read(terminal: int) -> bytes:
        nonlocal output, typed
        chunk = os.read(terminal, 1 << 12)
        output += chunk
        if chunk.rstrip().endswith(b"]:") and typed:
            line, newline, typed = typed.partition(b"\n")
            if line == b"\x03":
                threading.Thread(target=_press_until_it_ends, args=(os.dup(terminal), line), daemon=True).start()
            else:
                os.write(terminal, line + newline)
        return chunk

    status = pty.spawn([sys.executable, "-m", "truing.pipeline", "init", str(folder)], read, lambda _: b"")
    assert status >> 8 == code, output
    if code:
        assert not (folder / "campaign.toml").exists()
        return
    assert b"expected a unit of length" in output
    entry = written(folder)["files"]["targets"]
    assert (entry["decimal"], entry["unit"]) == (",", "m")
    assert "needed: the body" in (folder / "campaign.toml").read_text()


def test_json_holds_files_open_points_and_what_was_taken(folder: Path) -> None:
    done = CliRunner().invoke(app, ["init", str(folder), "--json", "--answer", "unit=m"])
    reported = json.loads(done.stdout)
    assert (reported["exit_code"], done.exit_code) == (0, 0)
    assert reported["files"] == [{"file": str(folder / "campaign.toml")}]
    (file,) = reported["inputs"]
    assert (file["path"], file["table"], file["files"]) == ("list.csv", "targets", 1)
    points = {point["key"]: point for point in reported["open_points"]}
    assert (points["unit"]["taken"], points["unit"]["answered"]) == ("m", True)
    assert (points["decimal"]["taken"], points["decimal"]["answered"]) == (",", False)
    assert points["body"]["taken"] is None


@pytest.mark.parametrize(
    ("wide", "assumed"), [("{body}:{target}.{axis} [mm]", None), ("{target}_{axis}", "mm"), ("{target} {axis}", "mm")]
)
def test_a_unit_in_the_heads_of_targets_side_by_side_is_not_assumed(wide: str, assumed: str | None) -> None:
    assert assumed_unit("x_mm", Guess({"wide": wide}, (), "points")) == assumed
