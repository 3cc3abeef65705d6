"""Atomic files: written next to their path, flushed to disk, then renamed."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from truing.pipeline.problems import environment

PART = ".part"  # extension of files that are still being written


def part_of(path: Path) -> Path:
    """Path of a file while it is written."""
    return path.with_name(f".{path.name}{PART}")


def write_part(path: Path, write: Callable[[BinaryIO], None]) -> str:
    """Write and flush the part file of ``path``, whose folder is made if absent; returns the SHA-256 of its bytes.

    Errors of ``write`` pass.
    """
    with environment(f"{path} cannot be written"):
        if not path.parent.exists():
            path.parent.mkdir(parents=True)
        file = open(part_of(path), "w+b")  # noqa: SIM115 (closed below; opening alone is the environment's)
    with file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest()


def publish_file(path: Path) -> None:
    """Rename the finished part file of ``path`` to its final name."""
    with environment(f"{path} cannot be renamed to its final name"):
        os.replace(part_of(path), path)


def sync_folder(folder: Path) -> None:
    """Make renames within ``folder`` durable against a power cut, where the system supports it."""
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # some network file systems cannot flush folders
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def discard_parts(paths: Iterable[Path]) -> None:
    """Remove the existing part files of ``paths``."""
    for path in paths:
        with suppress(OSError):  # the next run cleans up, and reports files that it cannot remove
            part_of(path).unlink(missing_ok=True)


def write_atomically(path: Path, content: bytes) -> None:
    """Write one small file atomically; raises EnvironmentProblem."""

    def write(file: BinaryIO) -> None:
        file.write(content)

    try:
        with environment(f"{path} cannot be written"):
            write_part(path, write)
        publish_file(path)
        sync_folder(path.parent)
    finally:
        discard_parts([path])
