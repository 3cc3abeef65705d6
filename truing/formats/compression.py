"""The bytes of a raw file without its compression."""

from __future__ import annotations

import bz2
import gzip
import lzma
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from truing.formats.source import RawFile

DAMAGED = (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile, zipfile.BadZipFile)
"""What reading a truncated or damaged compressed file raises."""

_MAGIC: dict[bytes, Callable[..., Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\x00": lzma.open}


@contextmanager
def open_plain(path: Path) -> Iterator[IO[bytes]]:
    """A file's bytes, decompressed where its first bytes say gz, bz2, xz, or zip with a single member."""
    with path.open("rb") as file:
        magic = file.read(6)
    opener = next((opener for start, opener in _MAGIC.items() if magic.startswith(start)), None)
    if magic.startswith(b"PK\x03\x04"):
        with zipfile.ZipFile(path) as archive, archive.open(_only_member(archive)) as stream:
            yield stream
    elif opener is not None:
        with opener(path, "rb") as stream:
            yield stream
    else:
        with path.open("rb") as stream:
            yield stream


def _only_member(archive: zipfile.ZipFile) -> str:
    members = [name for name in archive.namelist() if not name.endswith("/")]
    if len(members) != 1:
        raise zipfile.BadZipFile(f"a single file is expected inside, not {len(members)}")
    return members[0]


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
