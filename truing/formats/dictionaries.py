"""Dictionary-encoded text columns, so that operations on names run once per name, not once per row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from truing.formats.patterns import BoundedPattern


def strings(values: Sequence[object]) -> pa.Array:
    """Return values as Arrow text."""
    return pa.array([str(value) for value in values], pa.string())


def as_dictionary(values: pa.Array) -> pa.DictionaryArray:
    """Return any column as dictionary-encoded text without surrounding blanks; empty for null."""
    if not pa.types.is_dictionary(values.type) or values.null_count:
        values = values.cast(pa.string()).fill_null("").dictionary_encode()
    texts = values.dictionary.cast(pa.string())
    trimmed = pc.utf8_trim_whitespace(texts)
    return values if trimmed.equals(texts) else pa.DictionaryArray.from_arrays(values.indices, trimmed)


def compacted(values: pa.Array) -> pa.Array:
    """Return the same column; if dictionary-encoded, without unused names."""
    return values.cast(pa.string()).dictionary_encode() if pa.types.is_dictionary(values.type) else values


def with_values(column: pa.DictionaryArray, values: Sequence[str]) -> pa.DictionaryArray:
    """Return the same rows with other values in the dictionary."""
    return pa.DictionaryArray.from_arrays(column.indices, strings(values))


def constant(value: str, rows: int) -> pa.DictionaryArray:
    """Return the same text in every row."""
    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, dtype=np.int32)), strings([value]))


def codes(column: pa.DictionaryArray) -> NDArray[np.int32]:
    """Return the index into the dictionary of each row."""
    return np.asarray(column.indices)


def renamed(text: str, patterns: Sequence[tuple[BoundedPattern[str], str]]) -> str:
    """Return a name rewritten by the first regular expression that matches it completely."""
    for pattern, replacement in patterns:
        if match := pattern.fullmatch(text):
            return match.expand(replacement)
    return text


def integers(texts: pa.Array) -> pa.Array:
    """Return the integers in texts, null for other texts."""
    is_integer = pc.match_substring_regex(texts, r"^[+-]?\d{1,18}$")
    digits = pc.replace_substring_regex(pc.if_else(is_integer, texts, pa.scalar(None, pa.string())), r"^\+", "")
    return digits.cast(pa.int64())
