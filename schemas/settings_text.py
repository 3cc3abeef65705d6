"""Reader of settings and model files: text of bounded size from regular files, never from pipes or devices."""

from __future__ import annotations

import errno
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any

# A parsed TOML document, or a table of it: values by key.
Document = dict[str, Any]

LARGEST = 16 << 20  # bytes; the parser takes a hundred times that of memory
_NOTHING_THERE = {errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG}

DEEPEST = 64  # tables and lists within each other; what is read here needs six
# The parser needs minutes for a dotted key of thousands of parts.
_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++\s*+\.\s*+){{{DEEPEST}}}")

_OF_THE_SYSTEM = ("/proc", "/sys", "/dev")
_OF_MEMORY = "/dev/shm"  # contains ordinary files
NOTHING_SPECIAL = "no folder, pipe or device, and nothing of /proc, /sys or /dev"


class TooDeep(ValueError):
    """Tables or lists nested too deeply."""

    def __init__(self) -> None:
        super().__init__(f"at most {DEEPEST} tables or lists within each other")


class TooLarge(ValueError):
    """Text larger than any settings: ``size`` in bytes."""

    def __init__(self, size: int) -> None:
        self.size = size
        super().__init__(f"at most {LARGEST >> 20} MB; this one has {size >> 20} MB")


def read_settings_text(path: Path) -> str:
    """Return the text of a file in UTF-8.

    Raises FileNotFoundError if the path is no regular file (missing, a folder, a pipe, a device, circular links, an
    entry of /proc), TooLarge, and UnicodeDecodeError.
    """
    size = regular_size(path)
    if size > LARGEST:
        raise TooLarge(size)
    return path.read_text(encoding="utf-8-sig")


def parsed_toml(text: str) -> Document:
    """Parse a TOML text.

    Raises TooDeep, tomllib.TOMLDecodeError, and ValueError for integers with more digits than Python reads.
    """
    if _LONG_KEY.search(text):
        raise TooDeep
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise TooDeep from None
    level: list[dict[str, object] | list[object]] = [document]
    for _ in range(DEEPEST):
        level = [inner for table in level for inner in _nested_values(table) if isinstance(inner, dict | list)]
        if not level:
            return document
    raise TooDeep


def _nested_values(value: dict[str, object] | list[object]) -> list[object]:
    return list(value.values()) if isinstance(value, dict) else value


def regular_size(path: Path) -> int:
    """Return the size of a regular file in bytes; raises FileNotFoundError if there is none."""
    try:
        status = os.stat(path)
    except ValueError:  # a null character
        raise _missing_file(path) from None
    except OSError as error:
        if error.errno in _NOTHING_THERE:
            raise _missing_file(path) from None
        raise
    if not stat.S_ISREG(status.st_mode) or is_special(path):
        raise _missing_file(path)
    return status.st_size


def _missing_file(path: Path) -> FileNotFoundError:
    return FileNotFoundError(errno.ENOENT, "no regular file is there", str(path))


def is_special(path: Path) -> bool:
    """True if a path leads, also through links, to a file that the kernel generates; raises OSError.

    Such a file may hold secrets of the reading process, or block the reader for ever.
    """
    real = os.path.realpath(path)
    if any(real == folder or real.startswith(f"{folder}/") for folder in _OF_THE_SYSTEM):
        return not real.startswith(f"{_OF_MEMORY}/")
    status = os.stat(real)
    if status.st_dev in _devices():
        return True
    if status.st_size:
        return False
    try:
        with open(real, "rb") as file:  # size 0 but readable content, such as another mount of /proc
            return file.read(1) != b""
    except PermissionError:
        return False


def _devices() -> set[int]:
    """Device numbers of /proc and /sys, if mounted."""
    return {os.stat(folder).st_dev for folder in _OF_THE_SYSTEM[:2] if os.path.ismount(folder)}
