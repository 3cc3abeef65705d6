"""No file contains traces of a person's machine or of a package index."""

from __future__ import annotations

import re

from tests.packaging.source_tree import PROJECT, text_files

# Written in pieces, so that this file passes its own test.
STRAY = re.compile(
    "|".join(
        [
            r"(?<![\w.])/(?:wo" r"rk|ho" r"me|Us" r"ers)/\w+",
            r"pypi\." r"org|python" r"hosted",
            r"\bis" r"sue #?\d+|\bsub" r"agents?\b|\bC" r"EO\b|\bthis ses" r"sion\b",
            r"\bTO" r"DO\b|\bFIX" r"ME\b|\bX" r"XX\b",
        ]
    )
)


def test_no_file_has_words_of_the_workplace() -> None:
    found = {
        path.relative_to(PROJECT).as_posix(): match.group()
        for path in text_files()
        if (match := STRAY.search(path.read_text(encoding="utf-8")))
    }
    assert not found
