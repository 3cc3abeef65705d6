"""Files of settings and of models, read whole: text of a bounded size in a regular file, never a pipe or a device."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from schemas.special_files import is_special

LARGEST = 16 << 20  # bytes; the parser takes a hundred times that of memory
_NOTHING_THERE = {errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG}


class TooLarge(ValueError):
    """Text of a size that settings never have: ``size`` in bytes."""

    def __init__(self, size: int) -> None:
        self.size = size
        super().__init__(f"at most {LARGEST >> 20} MB; this one has {size >> 20} MB")


def read_settings_text(path: Path) -> str:
    """Return the text of a file in UTF-8.

    Raises FileNotFoundError where no regular file is there (nothing, a folder, a pipe, a device, links in a circle, an
    entry of /proc),
    TooLarge, and UnicodeDecodeError.
    """
    size = regular_size(path)
    if size > LARGEST:
        raise TooLarge(size)
    return path.read_text(encoding="utf-8-sig")


def regular_size(path: Path) -> int:
    """Return the bytes of a regular file; raises FileNotFoundError where there is none."""
    try:
        status = os.stat(path)
    except ValueError:  # a null character
        raise _none(path) from None
    except OSError as error:
        if error.errno in _NOTHING_THERE:
            raise _none(path) from None
        raise
    if not stat.S_ISREG(status.st_mode) or is_special(path):
        raise _none(path)
    return status.st_size


def _none(path: Path) -> FileNotFoundError:
    return FileNotFoundError(errno.ENOENT, "no regular file is there", str(path))
