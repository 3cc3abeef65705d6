"""The inference names epochs, channels and groups only, and treats models and causes by their types.

What was measured, and on what, is the models' business.
"""

from __future__ import annotations

import ast
import re
import tomllib

import pytest

from tests.packaging.source_tree import PROJECT, modules

# Words of one mechanism or instrument, singular; plurals count as well.
OF_ONE_INSTRUMENT = frozenset({
    "actuator", "attachment", "bench", "body", "camera", "encoder", "leg", "load", "platform", "point", "pose", "ray",
    "roll", "sensor", "target",
})  # fmt: skip
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def singular(word: str) -> str:
    return word.removesuffix("ies") + "y" if word.endswith("ies") else word.removesuffix("s")


def instruments_words(text: str) -> list[str]:
    """Words for instruments in a text, also within names of several words."""
    return [word for word in _WORD.findall(text) if singular(word.lower()) in OF_ONE_INSTRUMENT]


def test_words_within_names_are_found() -> None:
    assert instruments_words("of_pose LoadSteps BODIES rays_by_leg") == ["pose", "Load", "BODIES", "rays", "leg"]
    assert instruments_words("composed unload array everybody pointer") == []


@pytest.mark.parametrize("path", modules("truing/inference"), ids=lambda path: path.stem)
def test_no_name_and_no_sentence_speaks_of_an_instrument(path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    found = {number: words for number, line in enumerate(lines, 1) if (words := instruments_words(line))}
    assert not found, f"{path.name}: " + "; ".join(f"line {n}: {', '.join(words)}" for n, words in found.items())


# What `mypy --strict` asks for next to what the project asks of all modules.
STRICT = frozenset({
    "disallow_any_generics", "disallow_subclassing_any", "disallow_untyped_calls", "disallow_untyped_decorators",
    "extra_checks", "no_implicit_reexport", "warn_return_any", "warn_unused_ignores",
})  # fmt: skip


def test_types_are_checked_strictly() -> None:
    own = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mypy"]["overrides"]
    flags = next(override for override in own if override["module"] == ["truing.inference.*"])
    assert {name for name, value in flags.items() if value is True} >= STRICT


@pytest.mark.parametrize("path", modules("truing/inference"), ids=lambda path: path.stem)
def test_modules_use_neither_any_nor_type_ignore(path) -> None:
    text = path.read_text(encoding="utf-8")
    names = {getattr(node, "id", getattr(node, "attr", None)) for node in ast.walk(ast.parse(text))}
    assert "Any" not in names
    assert "type: ignore" not in text
