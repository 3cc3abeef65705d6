"""The checks of code blocks detect faulty blocks."""

from __future__ import annotations

import pytest

from tests.docs.campaign_fragment import fault_of_toml
from tests.docs.shell import commands, fault


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("truing run x --fast", "--fast"),
        ("truing walk x", "walk"),
        ("truing run", "CAMPAIGN"),
        ("truing design x --poses many", "--poses"),
        ("make pose speed", "speed"),
        ("python -m docs.experiments.nothing", "nothing"),
        ("python -m benchmarks.blind --fast", "--fast"),
        ("python mine.py", "python"),
        ("cat sample_data/nowhere/points.csv", "nowhere"),
        ("$ truing run x", "$"),
    ],
)
def test_a_command_that_does_not_exist_is_reported(line: str, expected: str) -> None:
    (words,) = commands(line)
    assert expected in (fault(words, set()) or "")


@pytest.mark.parametrize(
    "line", ["A=b .venv/bin/truing run x --qa warn", "make all CAMPAIGN=x", "python mine.py x", "cd x", "make pose"]
)
def test_an_existing_command_is_no_fault(line: str) -> None:
    (words,) = commands(line)
    assert fault(words, {"mine.py"}) is None


def test_a_line_is_split_into_its_commands() -> None:
    reported = list(commands("cd x && truing run . \\\n  --force  # again\n# nothing\nls | cat"))
    assert reported == [["cd", "x"], ["truing", "run", ".", "--force"], ["ls"], ["cat"]]


@pytest.mark.parametrize(
    "text",
    [
        "[noise]\npoint_um = 5",
        "[noise]\npoint_mm = -1",
        "[qa.limits.nothing]\nwarn = 1",
        "[mechanism]\ntype = '7-pus'",
        "[elsewhere]\nx = 1",
        "[project]\nname = 'x'",
    ],
)
def test_settings_that_truing_would_refuse_are_reported(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert fault_of_toml(text, "", monkeypatch) is not None
