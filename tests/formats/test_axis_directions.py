"""A recorded direction of approach is read by its words, and by the movements of the rows where these are clear."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.formats.reading import read
from truing.formats.guess import Guess
from truing.formats.sniff import sniff_file

COMMANDS = [0, 90, 180, 270, 360, 360, 270, 180, 90, 0]  # up and down again
UP = [True] * 5 + [False] * 5


def guess_of(folder: Path, head: str, words: tuple[str, str], commands: list[int], is_up: list[bool]) -> Guess:
    said = [words[0] if up else words[1] for up in is_up]
    rows = [f"{k};{at};{word};{0.001 * k}" for k, (at, word) in enumerate(zip(commands, said, strict=True))]
    text = "\n".join([f"Nr;Position [deg];{head};Abweichung [arcsec]", *rows]) + "\n"
    (folder / "axis.csv").write_text(text, encoding="utf-8")
    return sniff_file(folder / "axis.csv")


def approaches(folder: Path, guess: Guess) -> list[int]:
    assert guess.table is not None
    found = read(folder, guess.table, {"path": "axis.csv", **guess.mapping})
    assert not found.faults, found.faults
    return [int(value) for value in found.columns["approach"]]


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("Richtung", ("+", "-")),
        ("Sens", ("aller", "retour")),
        ("direction", ("forward", "backward")),
        ("+/-", ("1", "-1")),
        ("Anfahrrichtung", ("hin", "zurück")),
        ("Drehsinn", ("CW", "CCW")),  # no words of a sign: the movements say it
        ("Drehsinn", ("CCW", "CW")),
    ],
)
def test_words_of_a_direction_are_read_where_rows_move_as_they_say(
    tmp_path: Path, head: str, words: tuple[str, str]
) -> None:
    guess = guess_of(tmp_path, head, words, COMMANDS, UP)
    assert approaches(tmp_path, guess) == [1] * 5 + [-1] * 5
    assert [way.key for way in guess.ways] == []


def test_words_that_name_the_side_from_which_the_axis_comes_are_turned_by_the_movements(tmp_path: Path) -> None:
    guess = guess_of(tmp_path, "approach", ("-", "+"), COMMANDS, UP)
    assert approaches(tmp_path, guess) == [1] * 5 + [-1] * 5


@pytest.mark.parametrize(
    ("commands", "is_up"),
    [
        ([at for at in (0, 90, 180, 270, 360) for _ in range(2)], [True, False] * 5),  # sorted by position
        ([0, 90, 180, 270, 360] * 2, UP),  # both passes written with rising commands
    ],
)
def test_it_is_asked_what_words_mean_where_the_order_of_rows_does_not_say_it(
    tmp_path: Path, commands: list[int], is_up: list[bool]
) -> None:
    guess = guess_of(tmp_path, "Richtung", ("+", "-"), commands, is_up)
    (way,) = [way for way in guess.ways if way.key == "approach"]
    assert (way.taken, way.other) == ("+", "-")
    assert approaches(tmp_path, guess) == [1 if up else -1 for up in is_up]
    assert approaches(tmp_path, way.guess) == [-1 if up else 1 for up in is_up]


@pytest.mark.parametrize("words", [("left", "left"), ("warm", "cold")])
def test_one_word_alone_gives_no_direction(tmp_path: Path, words: tuple[str, str]) -> None:
    guess = guess_of(tmp_path, "Richtung" if words[0] == words[1] else "Zustand", words, COMMANDS, UP)
    assert "approach" not in guess.mapping.get("columns", {})


def test_rows_are_numbered_and_not_read_where_they_were_before(tmp_path: Path) -> None:
    guess = guess_of(tmp_path, "Richtung", ("+", "-"), COMMANDS, UP)
    assert "Richtung" not in guess.mapping.get("ignore", "")
    assert np.all(np.diff(read(tmp_path, "configurations", {"path": "axis.csv", **guess.mapping}).columns["pose"]) == 1)
