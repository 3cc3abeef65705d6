"""The command line: help with an example for each command, progress bars on terminals only, closed pipes."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.completion import completion_init
from typer.testing import CliRunner

from tests.pipeline.fake_project import STAGES, FakeProject
from tests.sentences import assert_says
from truing.pipeline.command_line import app
from truing.pipeline.completions import ANSWERS, campaigns, causes, runs
from truing.pipeline.console import JsonConsole
from truing.pipeline.init_questions import parsed_answers
from truing.pipeline.problems import ExitCode
from truing.pipeline.stage_order import ORDER, stage_module

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
COMMANDS = (
    *("run", "watch", "stages", "check", "init", "predict", "design", "power", "plan", "export", "report", "compare"),
)


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS)])
def test_help_explains_itself_with_an_example(command: tuple[str, ...]) -> None:
    shown = CliRunner().invoke(app, [*command, "--help"])
    assert shown.exit_code == 0
    assert f"Example: truing {' '.join(command)}" in shown.output


def test_help_lists_every_command_there_is() -> None:
    assert {command.name or command.callback.__name__ for command in app.registered_commands} == set(COMMANDS)


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; sys.argv = ['truing', '--help']\n"
        "from truing.pipeline.entry import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'pydantic', 'pyarrow', 'pandas', 'rich', 'numpy', 'scipy', 'plotly'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_nothing_to_do_imports_nothing_heavy(ran: FakeProject) -> None:
    code = (
        f"import sys; sys.argv = ['truing', 'run', {str(ran.campaign)!r}]\n"
        "from truing.pipeline.entry import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'pyarrow', 'pandas', 'rich', 'numpy', 'scipy', 'plotly', 'truing.schemas.campaign'}\n"
        "heavy &= set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ran.cwd, env=ran.environment(), capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert_says(done.stdout, "up to date")


def test_from_and_only_exclude_each_other(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign), "--from", "qa", "--only", "pose")
    assert done.returncode == 2
    assert "exclude each other" in done.stderr


def test_stages_without_a_campaign_lists_those_there_are(fake: FakeProject) -> None:
    done = fake.call("stages")
    assert done.returncode == 0
    assert "photogrammetry:" in done.stdout
    assert "reads points.csv" in done.stdout


def test_stages_of_a_campaign_never_run_writes_nothing(fake: FakeProject) -> None:
    assert {state.split("  ")[0] for state in fake.standings().values()} == {"never run"}
    assert list(fake.cwd.iterdir()) == []


def test_elsewhere_than_on_a_terminal_there_are_plain_lines(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign))
    assert "\x1b" not in done.stdout + done.stderr
    assert "\r" not in done.stdout
    assert [line.split()[0].rstrip(":") for line in done.stdout.splitlines()] == [*STAGES, "report", "exit"]


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_on_a_terminal_there_is_a_bar_that_vanishes(fake: FakeProject) -> None:
    import pty

    ours, theirs = pty.openpty()
    environment = {**fake.environment("pause0.5"), "TERM": "xterm", "COLUMNS": "100"}
    process = subprocess.Popen(
        fake.command("run", str(fake.campaign)), cwd=fake.cwd, env=environment, stdout=theirs, stderr=theirs
    )
    os.close(theirs)
    shown = b""
    while True:
        try:
            piece = os.read(ours, 4096)
        except OSError:  # Linux says so when the other end has closed
            break
        if not piece:
            break
        shown += piece
    os.close(ours)
    assert process.wait() == 0
    assert b"\x1b[2K" in shown, "the bar is erased"
    assert shown.count(b"left out nothing") == len(STAGES)


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX pipes")
def test_a_listener_who_goes_does_not_end_the_run(fake: FakeProject) -> None:
    process = subprocess.Popen(
        fake.command("run", str(fake.campaign)),
        cwd=fake.cwd,
        env=fake.environment("pause0.3"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    errors = process.stderr.read()
    process.stderr.close()
    assert (process.wait(), errors) == (0, b"")
    assert (fake.out / "report.html").exists()


def test_without_a_terminal_a_stage_has_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    from truing.pipeline.console import RunConsole

    console = RunConsole(quiet=False)
    with console.during("2/9 pose") as progress:
        for done in range(5):
            progress(done, 5, "poses")
    console.line("2/9 pose read 5 poses")
    assert capsys.readouterr().out.splitlines() == ["2/9 pose read 5 poses"]


def test_a_run_ends_with_its_verdict_and_the_reason_of_its_exit_code(fake: FakeProject) -> None:
    lines = fake.call("run", str(fake.campaign)).stdout.splitlines()
    stages = [found[1] for line in lines if (found := re.match(r"\w+ +(\d+/\d+): read", line))]
    assert stages == [f"{k}/{len(stages)}" for k in range(1, len(stages) + 1)]
    assert len(stages) > 1
    assert lines[-1] == f"exit code 0: {ExitCode.DONE.meaning}"


def test_json_of_a_run_is_one_object_with_stages_verdict_and_exit_code(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign), "--json")
    reported = json.loads(done.stdout)
    (campaign,) = reported["campaigns"]
    assert (reported["exit_code"], done.returncode, reported["meaning"]) == (0, 0, ExitCode.DONE.meaning)
    assert [stage["stage"] for stage in campaign["stages"] if stage["ran"]] == list(STAGES)
    again = json.loads(fake.call("run", str(fake.campaign), "--json").stdout)
    assert not any(stage["ran"] for stage in again["campaigns"][0]["stages"])


def test_json_of_faults_has_file_key_value_and_expectation(fake: FakeProject) -> None:
    fake.edit(fake.campaign / "campaign.toml", 'kind = "photogrammetry"', 'kind = "photogrametry"')
    for command in ("run", "check"):
        reported = json.loads(fake.call(command, str(fake.campaign), "--json").stdout)
        (fault,) = reported["faults"]
        assert (reported["exit_code"], fault["key"], fault["value"]) == (2, "campaign.kind", "photogrametry")
        assert fault["column"] == fault["key"]
        assert "photogrammetry" in fault["expected"]


def test_json_of_stages_has_a_row_per_stage(fake: FakeProject) -> None:
    rows = json.loads(fake.call("stages", str(fake.campaign), "--json").stdout)["stages"]
    assert [(row["stage"], row["state"]) for row in rows] == [(stage, "never run") for stage in STAGES]


def test_json_has_null_for_numbers_that_it_lacks(capsys: pytest.CaptureFixture[str]) -> None:
    console = JsonConsole()
    console.add_fact("rows", {"x": math.nan, "sizes": (math.inf, 1.0)})
    console.close(ExitCode.DONE)
    assert json.loads(capsys.readouterr().out)["rows"] == [{"x": None, "sizes": [None, 1.0]}]


def test_verbose_says_why_a_stage_runs_or_not(ran: FakeProject) -> None:
    reported = ran.call("run", str(ran.campaign), "-v").stdout
    assert re.findall(r"^(\w+) +\d+/\d+: fresh", reported, re.MULTILINE) == list(STAGES)
    assert "fresh" not in ran.call("run", str(ran.campaign)).stdout


def test_a_stage_that_is_nearly_one_is_suggested(fake: FakeProject) -> None:
    assert "did you mean pose?" in fake.call("run", str(fake.campaign), "--only", "poes").stderr


@pytest.mark.parametrize(
    ("shell", "asked", "environment"),
    [
        ("bash", "complete_bash", {"COMP_WORDS": "truing re", "COMP_CWORD": "1"}),
        ("zsh", "complete_zsh", {"_TYPER_COMPLETE_ARGS": "truing re"}),
        ("fish", "complete_fish", {"_TYPER_COMPLETE_FISH_ACTION": "get-args", "_TYPER_COMPLETE_ARGS": "truing re"}),
    ],
)
def test_each_shell_gets_a_script_and_its_completions(shell: str, asked: str, environment: dict[str, str]) -> None:
    script = CliRunner().invoke(app, ["--completion", shell])
    assert script.exit_code == 0
    assert asked in script.output
    code = "from truing.pipeline.entry import main; import sys; sys.argv = ['truing']; main()"
    given = {**os.environ, **environment, "_TRUING_COMPLETE": asked}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=given)
    assert "report" in done.stdout
    assert "design" not in done.stdout


def test_help_texts_hold_no_quotation_mark_that_zsh_drops() -> None:
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    texts = {name: command.get_short_help_str(200) for name, command in commands.items()}
    texts |= {f"{name} {p.name}": getattr(p, "help", "") for name, own in commands.items() for p in own.params}
    for order in ORDER.values():
        texts |= {f"stage {name}": stage_module(name).DECLARATION.summary for name in order}
    texts |= dict(causes(typer.Context(commands["power"]), ""))
    assert len(texts) > 100
    assert [name for name, text in texts.items() if re.search("['\"`$]", text or "")] == []


@pytest.mark.parametrize(
    ("words", "begun", "expected", "absent"),
    [
        ("run {telescope} --only", "", {"ingest", "calibrate"}, {"images", "bundle"}),
        ("run --from", "po", {"pose"}, {"images"}),
        ("power {robot} --causes", "joint-offset,link", {"joint-offset,link-bending"}, {"joint-offset,leg-drift"}),
        ("power --causes", "leg-", {"leg-drift"}, {"unexplained", "joint-offset"}),
        ("export runs/telescope --to", "csv,", {"csv,xlsx", "csv,dcc"}, {"csv,csv"}),
        ("init folder --answer", "ta", {"table=targets", "table=points"}, {"unit=mm"}),
    ],
)
def test_names_are_completed_by_what_the_line_says(
    words: str, begun: str, expected: set[str], absent: set[str]
) -> None:
    places = {name: f"{SAMPLES / name}" for name in ("telescope", "robot")}
    line = f"truing {words.format(**places)} {begun}"
    asked = {"_TRUING_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words.split()) + 1)}
    completion_init()
    found = set(CliRunner().invoke(app, [], env=asked).output.split())
    assert expected <= found
    assert not absent & found
    assert all(name.startswith(begun) for name in found)


def test_folders_of_campaigns_and_runs_are_completed_and_suggested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("runs/first/.truing", "runs/notes", "data/first", "alone"):
        (tmp_path / folder).mkdir(parents=True)
    for folder in ("data/first", "alone"):
        (tmp_path / folder / "campaign.toml").write_text("")
    monkeypatch.chdir(tmp_path)
    context = typer.Context(typer.main.get_command(app))
    found = {begun: [name for name, _ in campaigns(context, begun)] for begun in ("", "da", "data/f", "x")}
    assert found == {"": ["alone", "data/first"], "da": ["data/first"], "data/f": ["data/first"], "x": []}
    assert [name for name, _ in runs(context, "")] == ["runs/first"]
    for words in (["check", "data/frist"], ["init", "data/firs"], ["report", "runs/firts"]):
        done = CliRunner().invoke(app, words)
        assert f"did you mean {words[1].partition('/')[0]}/first?" in done.stderr


def test_every_answer_that_is_completed_is_one_of_init() -> None:
    assert len(parsed_answers([f"file{number}:{text}" for number, text in enumerate(ANSWERS)])) == len(ANSWERS)


def test_lines_of_the_list_of_commands_are_not_cut() -> None:
    shown = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "80"}).output
    assert "..." not in shown.partition("Commands:")[2]


def test_examples_of_the_help_texts_run_in_the_folder_of_the_project() -> None:
    """Paths of an example are there, are results of a run, or begin with ``my-`` and are the reader's own."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    examples = [
        shlex.split(" ".join(text.split()))
        for command in commands.values()
        for text in re.findall(r"Example: truing (.+?)(?=\n\s*\n|\Z)", command.help or "", re.DOTALL)
    ]
    assert len(examples) >= len(commands)
    for name, *words in examples:
        values = {words[k + 1] for k, word in enumerate(words[:-1]) if word.startswith("-")}
        paths = [word for word in words if not word.startswith("-") and word not in values]
        assert name in commands
        for path in paths:
            assert (SAMPLES.parent / path).exists() or path.startswith(("runs/", "my-")), (name, path)
