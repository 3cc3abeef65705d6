"""The bytes of a raw file without its compression, as a stream: nothing is unpacked to where an archive says."""

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
    """A compressed file that is whole, but none that is read: what was expected of it, and what was found."""

    def __init__(self, expected: str, found: str | None = None) -> None:
        self.expected, self.found = expected, found
        super().__init__(f"expected {expected}")


DAMAGED = (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile, zipfile.BadZipFile, Refused)
"""What reading a truncated, damaged or refused compressed file raises."""

_MAGIC: dict[bytes, Callable[..., Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\x00": lzma.open}
_ZIP = (b"PK\x03\x04", b"PK\x05\x06")  # the second: an archive without members
_OLD_WORKBOOK = b"\xd0\xcf\x11\xe0"
_OF_WORKBOOKS = {"[Content_Types].xml", "content.xml"}  # of Excel, and of OpenDocument
_AS_CSV = "text, or a workbook that is saved as .xlsx"
# Measured numbers shrink to a half or a tenth, logs that stand still to a hundredth.
LARGEST_RATIO = 250
FREE = 64 << 20  # bytes that any file may unpack to
LARGEST = 64 << 30


@contextmanager
def open_plain(path: Path) -> Iterator[IO[bytes]]:
    """A file's bytes, decompressed where its first bytes say gz, bz2, xz, or zip with a single member.

    Raises Refused where there is one compression within another, and, while it is read, where it grows out of all
    proportion to the file.
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
    """The only file inside, whatever its name: it names no place to write to. What macOS adds for itself is none."""
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
    """A stream that ends with Refused where it becomes out of all proportion to the file that it comes from."""

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self._stream = stream
        self._left = min(max(FREE, LARGEST_RATIO * size), LARGEST)

    def readable(self) -> bool:
        """As every stream that is read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer; returns how many bytes there were."""
        data = self._stream.read(len(buffer))
        self._left -= len(data)
        if self._left < 0:
            raise Refused(f"content of at most {LARGEST_RATIO} times the compressed size; this one is made to explode")
        buffer[: len(data)] = data
        return len(data)


@contextmanager
def plain_path(raw: RawFile) -> Iterator[Path]:
    """A path to the file without compression, for libraries that open paths: itself, or a temporary copy."""
    if raw.path.suffix.lower() == raw.suffix:
        yield raw.path
        return
    with tempfile.TemporaryDirectory(prefix="truing-") as folder, open_plain(raw.path) as stream:
        copy = Path(folder) / f"plain{raw.suffix}"
        with copy.open("wb") as target:
            while chunk := stream.read(1 << 20):
                target.write(chunk)
        yield copy
