"""Notations of numbers: decimal commas, thousands separators, values that mean missing."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from truing.arrays import Array, Mask
from truing.formats.sexagesimal import is_marked_angle

_SEPARATOR_CLASS = {None: "", ",": ",", ".": r"\.", "'": "['’]", " ": "[ \u00a0\u2009\u202f]"}
_EXPONENT = r"([eEdD][+-]?\d+)?"


@dataclass(frozen=True)
class Notation:
    """Notation of the numbers of a file."""

    decimal: str = "."
    thousands: str | None = None
    missing: frozenset[str] = frozenset()

    @cached_property
    def pattern(self) -> str:
        """Regular expression of a number; thousands separators only between groups of three digits."""
        mark = re.escape(self.decimal)
        grouped = ""
        if self.thousands is not None:
            grouped = rf"\d{{1,3}}({_SEPARATOR_CLASS[self.thousands]}\d{{3}})+|"
        return rf"^[+-]?(({grouped}\d+)({mark}\d*)?|{mark}\d+){_EXPONENT}$|^[+-]?(?i:nan|inf|infinity)$"

    @property
    def missing_numbers(self) -> tuple[float, ...]:
        """Single numbers that mean missing, in any notation."""
        return tuple(float(text) for text in sorted(self.missing) if is_plain_number(text))

    @property
    def missing_triples(self) -> tuple[tuple[float, float, float], ...]:
        """Values such as ``0 0 0`` that mean missing if all three coordinates have them."""
        triples = [tuple(map(float, text.split())) for text in sorted(self.missing) if _is_triple(text)]
        return tuple((a, b, c) for a, b, c in triples)

    def parse(self, texts: pa.Array) -> tuple[pa.Array, Mask]:
        """Return numbers (float64, null for empty or missing), and the mask of texts that are no numbers."""
        texts = pc.utf8_trim_whitespace(texts.cast(pa.string()))
        absent = pc.is_in(texts, value_set=pa.array(["", *sorted(self.missing)], pa.string()))
        absent = pc.or_(absent, pc.is_null(texts))
        texts = pc.replace_substring(texts, "\u2212", "-")
        good = pc.and_(pc.match_substring_regex(texts, self.pattern), pc.invert(absent))
        plain = pc.if_else(pc.fill_null(good, False), self._plain(texts), pa.scalar(None, pa.string()))
        bad = np.asarray(pc.and_(pc.is_null(plain), pc.invert(absent)).to_numpy(zero_copy_only=False), dtype=bool)
        return plain.cast(pa.float64()), bad

    def matrix(self, records: Sequence[Sequence[str]]) -> Array:
        """Return the cells of N records as numbers (N, W), NaN for other cells."""
        columns = [self.parse(pa.array(column, pa.string()))[0] for column in zip(*records, strict=True)]
        return np.column_stack([np.asarray(column.fill_null(np.nan), dtype=float) for column in columns])

    def _plain(self, texts: pa.Array) -> pa.Array:
        if self.thousands is not None:
            texts = pc.replace_substring_regex(texts, _SEPARATOR_CLASS[self.thousands], "")
        if self.decimal != ".":
            texts = pc.replace_substring(texts, self.decimal, ".")
        texts = pc.replace_substring_regex(texts, r"^\+", "")
        return pc.replace_substring_regex(texts, r"(\d\.?)[dD]([+-]?\d)", r"\1e\2")

    def advice(self, text: str) -> str:
        """Return the expectation for a text that is no number, with the setting that would read it, if any."""
        for decimal, thousands in (
            (",", None),
            (".", None),
            (".", ","),
            (",", "."),
            (".", "'"),
            (".", " "),
            (",", " "),
        ):
            other = Notation(decimal, thousands, self.missing)
            if re.match(other.pattern, text.strip()):
                return f"a number; to read this one set {_settings(self, other)}"
        if is_marked_angle(text):
            return 'a number; an angle in degrees, minutes and seconds has the unit "dms"'
        return "a number"


def _settings(now: Notation, then: Notation) -> str:
    parts = [f'decimal = "{then.decimal}"'] if now.decimal != then.decimal else []
    parts += [f'thousands = "{then.thousands}"'] if then.thousands and now.thousands != then.thousands else []
    return " and ".join(parts) or "another notation"


def is_plain_number(text: str) -> bool:
    """True if Python reads a text as a finite number."""
    return re.fullmatch(Notation().pattern, text.strip()) is not None and text.strip()[-1].isdigit()


def _is_triple(text: str) -> bool:
    parts = text.split()
    return len(parts) == 3 and all(is_plain_number(part) for part in parts)
