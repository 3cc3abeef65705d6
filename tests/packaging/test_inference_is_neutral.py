"""The inference speaks of epochs, channels and groups: what was measured, and on what, is the models' business."""

from __future__ import annotations

import re

import pytest

from tests.packaging.source_tree import modules

# Words of one mechanism or instrument, singular; plurals count as well.
OF_ONE_INSTRUMENT = frozenset({"body", "leg", "load", "platform", "point", "pose", "ray", "target"})
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def singular(word: str) -> str:
    return word.removesuffix("ies") + "y" if word.endswith("ies") else word.removesuffix("s")


def instruments_words(text: str) -> list[str]:
    """Words of instruments in a text, within names of several words as well."""
    return [word for word in _WORD.findall(text) if singular(word.lower()) in OF_ONE_INSTRUMENT]


def test_words_within_names_are_found() -> None:
    assert instruments_words("of_pose LoadSteps BODIES rays_by_leg") == ["pose", "Load", "BODIES", "rays", "leg"]
    assert instruments_words("composed unload array everybody pointer") == []


@pytest.mark.parametrize("path", modules("truing/inference"), ids=lambda path: path.stem)
def test_no_name_and_no_sentence_speaks_of_an_instrument(path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    found = {number: words for number, line in enumerate(lines, 1) if (words := instruments_words(line))}
    assert not found, f"{path.name}: " + "; ".join(f"line {n}: {', '.join(words)}" for n, words in found.items())
