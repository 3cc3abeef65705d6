"""Lines above blocks of rows, such as ``EPOCH 3``: what they name becomes columns of the rows below."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from truing.formats.patterns import BoundedPattern
from truing.formats.text import Lines, split_lines

_END = re.compile(rb"[\r\n]*\Z")
_NOTHING = b"-"  # in place of an empty value between blanks
# Words before the number of a pose, at the begin of a line.
_HEAD = re.compile(
    r"[\W_]*(?P<word>pose?|position|epoche?|époque|frame|shot|measurement|messung|aufnahme|stellung|lage|station)"
    r"[\s_:.#=-]*(?:(?:nr|no)\W*)?(?P<number>\d+)\b",
    re.IGNORECASE,
)
_FEWEST = 2


@dataclass(frozen=True)
class BlockHeads:
    """The expression of these lines, and the separator of the cells to append."""

    pattern: BoundedPattern[bytes]
    separator: str
    lines: Lines

    @property
    def names(self) -> tuple[str, ...]:
        """Columns that the lines give, in order."""
        return tuple(self.pattern.groupindex)

    def applied(self, blocks: Iterator[bytes]) -> Iterator[bytes]:
        """Yield blocks of a file in order: every record with the cells of the last head above it, heads blank."""
        cells = [""] * len(self.names)
        for block in blocks:
            found = []
            for line in split_lines(block, self.lines.quote):
                end = _END.search(line)
                ending = b"" if end is None else end[0]
                if match := self.pattern.search(line):
                    cells = [(text or b"").decode(errors="replace") for text in match.groupdict().values()]
                    found.append(ending)
                elif self.lines.is_record(line):
                    found.append(line[: len(line) - len(ending)] + self._tail(cells) + ending)
                else:
                    found.append(line)
            yield b"".join(found)

    def _tail(self, cells: Sequence[str]) -> bytes:
        if self.separator == "whitespace":
            words = [re.sub(r"\s+", "_", cell.strip()).encode() or _NOTHING for cell in cells]
            return b"".join(b" " + word for word in words)
        separator = self.separator
        return "".join(separator + cell.strip().replace(separator, " ") for cell in cells).encode()


def heads_of_poses(lines: Sequence[str]) -> str | None:
    """Return an expression for lines that number the poses of the rows below them; None without several of them.

    Each number stands once, and rows follow each of these lines.
    """
    places = [(place, match) for place, line in enumerate(lines) if (match := _HEAD.match(line))]
    words = {match["word"].casefold() for _, match in places}
    numbers = [int(match["number"]) for _, match in places]
    gaps = [second[0] - first[0] for first, second in pairwise(places)]
    if len(places) < _FEWEST or len(words) != 1 or len(set(numbers)) < len(numbers) or min(gaps) < _FEWEST:
        return None
    return rf"(?i)^[\W_]*{words.pop()}\D*?(?P<pose>\d+)"
