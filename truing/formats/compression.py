"""Decompressed raw files as streams; no archive member is written to the path that it names."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from truing.formats.source import RawFile


class Refused(Exception):
    """A compressed file that is valid but not supported: expected and found content."""

    def __init__(self, expected: str, actual: str | None = None) -> None:
        self.expected, self.found = expected, actual
        super().__init__(f"expected {expected}")


DAMAGED = (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile, zipfile.BadZipFile, Refused)
"""Errors of reading a truncated, damaged or refused compressed file."""

_MAGIC: dict[bytes, Callable[..., Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\x00": lzma.open}
_ZIP = (b"PK\x03\x04", b"PK\x05\x06")  # the second: an empty archive
_OLD_WORKBOOK = b"\xd0\xcf\x11\xe0"
_OF_WORKBOOKS = {"[Content_Types].xml", "content.xml"}  # of Excel, and of OpenDocument
_AS_CSV = "text, or a workbook that is saved as .xlsx"
# Measured numbers compress to a half or a tenth, logs with constant values to a hundredth.
LARGEST_RATIO = 250
FREE = 64 << 20  # decompressed bytes that are always allowed
LARGEST = 64 << 30


@contextmanager
def open_plain(path: Path) -> Iterator[IO[bytes]]:
    """Yield a file's bytes, decompressed if its first bytes are those of gz, bz2, xz, or zip with a single member.

    Raises Refused for nested compression, and during reading if the content grows beyond the allowed ratio.
    """
    with path.open("rb") as file:
        magic = file.read(6)
    if magic.startswith(_OLD_WORKBOOK):
        raise Refused(_AS_CSV, "a workbook")
    opener = next((opener for start, opener in _MAGIC.items() if magic.startswith(start)), None)
    if magic.startswith(_ZIP):
        with zipfile.ZipFile(path) as archive, _member(archive) as stream:
            yield _bounded(stream, path)
    elif opener is not None:
        with opener(path, "rb") as stream:
            yield _bounded(stream, path)
    else:
        with path.open("rb") as stream:
            yield stream


def _member(archive: zipfile.ZipFile) -> IO[bytes]:
    """Return the only file of an archive, under any name; files added by macOS are ignored."""
    members = [name for name in archive.namelist() if not name.endswith("/") and not name.startswith("__MACOSX/")]
    if len(members) > 1 and not _OF_WORKBOOKS.isdisjoint(members):
        raise Refused(_AS_CSV, "a workbook")
    if len(members) != 1:
        raise Refused("an archive with a single file inside", f"{len(members)} files")
    try:
        return archive.open(members[0])
    except (RuntimeError, NotImplementedError):
        raise Refused("an archive without password, compressed by deflate, bzip2 or lzma") from None


def _bounded(stream: IO[bytes], path: Path) -> IO[bytes]:
    plain = io.BufferedReader(_Bounded(stream, path.stat().st_size), 1 << 20)
    if plain.peek(6).startswith((*_MAGIC, *_ZIP)):
        raise Refused("one compression, not one within another")
    return plain


class _Bounded(io.RawIOBase):
    """A stream that raises Refused when its content exceeds the allowed ratio to the compressed size."""

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self._stream = stream
        self._left = min(max(FREE, LARGEST_RATIO * size), LARGEST)

    def readable(self) -> bool:
        """Return True, as for every readable stream."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer; return the number of bytes."""
        data = self._stream.read(len(buffer))
        self._left -= len(data)
        if self._left < 0:
            raise Refused(
                f"content of at most {LARGEST_RATIO} times the compressed size; this one may be a decompression bomb"
            )
        buffer[: len(data)] = data
        return len(data)


@contextmanager
def plain_path(raw: RawFile) -> Iterator[Path]:
    """Yield a path to the decompressed file, for libraries that open paths: the file itself, or a temporary copy."""
    if raw.path.suffix.lower() == raw.suffix:
        yield raw.path
        return
    with tempfile.TemporaryDirectory(prefix="truing-") as folder, open_plain(raw.path) as stream:
        copy = Path(folder) / f"plain{raw.suffix}"
        with copy.open("wb") as target:
            while chunk := stream.read(1 << 20):
                target.write(chunk)
        yield copy
