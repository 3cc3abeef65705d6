"""Text files as UTF-8 blocks that end with a record; the only place that decides which lines are records."""

from __future__ import annotations

import codecs
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import IO

from truing.formats.patterns import BoundedPattern
from truing.schemas.mapping import FileMapping

BLOCK = 4 << 20
_LONGEST_RECORD = 64 << 20
_MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))


class OpenQuotation(ValueError):
    """A quotation mark without a closing one."""


class EndlessLine(ValueError):
    """A line longer than any record."""

    longest = _LONGEST_RECORD


@dataclass(frozen=True)
class Lines:
    """Rule for records: lines that are not blank, no comment, no head of a block, and match ``keep``."""

    comment: bytes | None
    quote: bytes
    keep: BoundedPattern[bytes] | None
    blanks: bytes
    heads: BoundedPattern[bytes] | None = None

    @classmethod
    def of(cls, entry: FileMapping, separator: str) -> Lines:
        """Return the rules of a mapping; a line of only separators is blank, as in exports of spreadsheets."""
        blanks = b" \t\r\n\f" + (b"" if separator == "whitespace" else separator.encode())
        keep = None if entry.keep_lines is None else BoundedPattern(entry.keep_lines.encode(), "keep_lines")
        comment = entry.comment.encode() if entry.comment else None
        heads = None if entry.heads is None else BoundedPattern(entry.heads.encode(), "heads")
        return cls(comment, entry.quote.encode(), keep, blanks, heads)

    def of_heading(self) -> Lines:
        """Return the same rules for the header line, to which ``keep`` does not apply."""
        return Lines(self.comment, self.quote, None, self.blanks, self.heads)

    def is_record(self, line: bytes) -> bool:
        """True if a line (or several, inside quotation marks) is a record."""
        bare = line.strip(self.blanks)
        if not bare or (self.comment is not None and bare.startswith(self.comment)):
            return False
        if self.heads is not None and self.heads.search(line) is not None:
            return False
        return self.keep is None or self.keep.search(line) is not None

    def records(self, block: bytes) -> bytes:
        """Return a block with only its records."""
        return b"".join(line for line in split_lines(block, self.quote) if self.is_record(line))

    def may_pass_over(self, block: bytes) -> bool:
        """True if a block may hold lines other than records and blank ones, which parsers would not handle."""
        return self.keep is not None or (self.comment is not None and self.comment in block)


def utf8_chunks(stream: IO[bytes], encoding: str, size: int = BLOCK) -> Iterator[bytes]:
    """Yield the text of a stream as UTF-8 with line feeds; a byte-order mark overrides the declared encoding.

    Raises UnicodeDecodeError if a declared encoding other than UTF-8 does not fit; the parser checks UTF-8.
    """
    chunk = stream.read(size)
    for mark, marked in _MARKS:
        if chunk.startswith(mark):
            chunk, encoding = chunk[len(mark) :], marked
    decoder = None if codecs.lookup(encoding).name == "utf-8" else codecs.getincrementaldecoder(encoding)()
    only_returns = b"\r" in chunk and not any(end in chunk for end in (b"\n", b"\r\x00\n"))
    while chunk:
        text = chunk if decoder is None else decoder.decode(chunk).encode()
        yield text.replace(b"\r", b"\n") if only_returns else text
        chunk = stream.read(size)
    if decoder is not None:
        yield decoder.decode(b"", final=True).encode()


def record_blocks(chunks: Iterator[bytes], quote: bytes) -> Iterator[bytes]:
    """Yield blocks that end with a record; line feeds between quotation marks end none.

    Raises OpenQuotation and EndlessLine.
    """
    unfinished = b""
    for chunk in chunks:
        if quote and (quote in chunk or quote in unfinished):
            chunk, unfinished = unfinished + chunk, b""
        cut = _last_end(chunk, quote)
        if cut:
            yield b"".join((unfinished, memoryview(chunk)[:cut]))
            unfinished = chunk[cut:]
        else:
            unfinished += chunk
        if len(unfinished) > _LONGEST_RECORD:
            raise OpenQuotation if quote and quote in unfinished else EndlessLine
    if quote and unfinished.count(quote) % 2:
        raise OpenQuotation
    if unfinished:
        yield unfinished


def _last_end(data: bytes, quote: bytes) -> int:
    cut = data.rfind(b"\n") + 1
    if quote and quote in data:
        while cut and data.count(quote, 0, cut) % 2:
            cut = data.rfind(b"\n", 0, cut - 1) + 1
    return cut


def split_lines(block: bytes, quote: bytes) -> list[bytes]:
    """Return lines with their ends; lines joined by quotation marks stay together."""
    lines = block.splitlines(keepends=True)
    if not quote or quote not in block:
        return lines
    joined: list[bytes] = []
    is_open = False
    for line in lines:
        if is_open:
            joined[-1] += line
        else:
            joined.append(line)
        is_open ^= line.count(quote) % 2 == 1
    return joined


def skip_lines(block: bytes, count: int) -> bytes:
    """Return a block without its first lines."""
    start = 0
    for _ in range(count):
        start = block.find(b"\n", start) + 1
        if start == 0:
            return b""
    return block[start:]


def take_record(block: bytes, lines: Lines) -> tuple[bytes | None, bytes]:
    """Return the first record and the rest of a block; None if there is no record."""
    start = 0
    for line in split_lines(block, lines.quote):
        start += len(line)
        if lines.is_record(line):
            return line, block[start:]
    return None, b""


def line_numbers(
    stream: IO[bytes], entry: FileMapping, lines: Lines, has_header: bool, records: Sequence[int]
) -> list[int]:
    """Return the lines (from 1) at which records (from 0, ascending) begin; reads the file again."""
    wanted = iter(records)
    numbers: list[int] = []
    next_wanted = next(wanted, None)
    line_number, record = 1, -1
    passed = entry.skip_lines
    heading = lines.of_heading()
    for block in record_blocks(utf8_chunks(stream, entry.encoding), lines.quote):
        for line in split_lines(block, lines.quote):
            if next_wanted is None:
                return numbers
            begins, line_number = line_number, line_number + max(line.count(b"\n"), 1)
            if passed:
                passed -= 1
            elif has_header:
                has_header = not heading.is_record(line)
            elif lines.is_record(line):
                record += 1
                if record == next_wanted:
                    numbers.append(begins)
                    next_wanted = next(wanted, None)
    return numbers
