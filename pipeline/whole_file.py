"""Files appear whole or not at all: written beside their place, flushed to the disk, then renamed."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from truing.pipeline.problems import environment

PART = ".part"  # ending of files that are still being written


def part_of(path: Path) -> Path:
    """Where ``path`` is written before it appears."""
    return path.with_name(f".{path.name}{PART}")


def write_part(path: Path, write: Callable[[BinaryIO], None]) -> str:
    """Write and flush the part file of ``path``; returns the SHA-256 of its bytes. ``write``'s errors pass."""
    with environment(f"{path} cannot be written"):
        file = open(part_of(path), "w+b")  # noqa: SIM115 (closed below; opening alone is the environment's)
    with file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest()


def reveal(path: Path) -> None:
    """Put the finished part file of ``path`` in its place."""
    with environment(f"{path} cannot be put in place"):
        os.replace(part_of(path), path)


def sync_folder(folder: Path) -> None:
    """Make renames within ``folder`` survive a power cut, where the system can."""
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # some network file systems know no flushing of folders
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def discard_parts(paths: Iterable[Path]) -> None:
    """Remove the part files of ``paths``, those that exist."""
    for path in paths:
        with suppress(OSError):  # the next run sweeps, and says what it cannot remove
            part_of(path).unlink(missing_ok=True)


def write_atomically(path: Path, content: bytes) -> None:
    """Write one small file whole; raises EnvironmentProblem where that is prevented."""

    def write(file: BinaryIO) -> None:
        file.write(content)

    try:
        with environment(f"{path} cannot be written"):
            write_part(path, write)
        reveal(path)
        sync_folder(path.parent)
    finally:
        discard_parts([path])
