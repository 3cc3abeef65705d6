"""Changes of a text in a file, which fail where the text is missing."""

from __future__ import annotations

from pathlib import Path


def replace_text(file: Path, old: str, new: str, times: int = -1) -> None:
    """Replace a text that the file holds, everywhere or the given number of times from the start."""
    text = file.read_text(encoding="utf-8")
    assert old in text, f"{file.name} holds no {old!r}"
    file.write_text(text.replace(old, new, times), encoding="utf-8")
