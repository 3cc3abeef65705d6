"""Text columns as dictionaries: what is done to names is done once per name, not once per row."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyarrow as pa


def strings(values: Sequence[object]) -> pa.Array:
    """Values as Arrow text."""
    import pyarrow as pa

    return pa.array([str(value) for value in values], pa.string())


def as_dictionary(values: pa.Array) -> pa.DictionaryArray:
    """Any column as dictionary-encoded text without blanks around it; empty where it was null."""
    import pyarrow as pa

    if not pa.types.is_dictionary(values.type) or values.null_count:
        values = values.cast(pa.string()).fill_null("").dictionary_encode()
    texts = values.dictionary.cast(pa.string()).to_pylist()
    trimmed = [(text or "").strip() for text in texts]
    return values if trimmed == texts else with_values(values, trimmed)


def with_values(column: pa.DictionaryArray, values: Sequence[str]) -> pa.DictionaryArray:
    """The same rows with other values in the dictionary."""
    import pyarrow as pa

    return pa.DictionaryArray.from_arrays(column.indices, strings(values))


def constant(value: str, rows: int) -> pa.DictionaryArray:
    """The same text in every row."""
    import pyarrow as pa

    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, dtype=np.int32)), strings([value]))


def codes(column: pa.DictionaryArray) -> NDArray[np.int32]:
    """Which value of the dictionary each row has."""
    return np.asarray(column.indices)


def renamed(text: str, patterns: Sequence[tuple[re.Pattern[str], str]]) -> str:
    """What a name becomes by the first regular expression that fits it whole."""
    for pattern, replacement in patterns:
        if match := pattern.fullmatch(text):
            return match.expand(replacement)
    return text


def whole_number(text: str) -> int | None:
    """The integer that a text writes, else None."""
    digits = text.removeprefix("-").removeprefix("+")
    return int(text) if digits.isascii() and digits.isdecimal() and len(digits) < 19 else None
