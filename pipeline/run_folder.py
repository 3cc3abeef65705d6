"""The folder of one run: locked while in use, cleaned of remains of dead runs, never left incomplete.

One run per folder: an operating-system lock, which a dead process cannot hold. The lock file names its holder. filelock
locks the first byte of the file, which hides that name from others on Windows.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from truing.pipeline.atomic_file import PART, part_of
from truing.pipeline.problems import EnvironmentProblem, environment
from truing.schemas.artifacts import ARTIFACTS

PRIVATE = ".truing"  # manifest, digest cache and lock; deleting it loses no result

# Windows locks are mandatory, so the locked byte lies after the note that others must be able to read.
_LOCKED_BYTE = 1 << 20


@contextmanager
def locked_folder(folder: Path) -> Iterator[Path]:
    """The locked run folder, created if needed; removed again if it stays empty."""
    created = _make(folder / PRIVATE)
    lock = folder / PRIVATE / "lock"
    with hold(lock):
        _sweep(folder)
        try:
            yield folder
        finally:
            _remove_empty(lock, created)


def _make(folder: Path) -> list[Path]:
    """Create a folder with its parents; returns the created ones, innermost first."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    with environment(f"the run folder {folder.parent} cannot be created"):
        folder.mkdir(parents=True, exist_ok=True)
    return missing


def _sweep(folder: Path) -> None:
    with environment(f"the run folder {folder} cannot be cleaned up"):
        parts = [part_of(folder / artifact.file) for artifact in ARTIFACTS.values()]
        for leftover in (*parts, *(folder / PRIVATE).glob(f".*{PART}")):
            leftover.unlink(missing_ok=True)


def _remove_empty(lock: Path, created: list[Path]) -> None:
    try:
        if not created or any(entry != lock for entry in lock.parent.iterdir()):
            return
        lock.unlink()
        for path in created:
            path.rmdir()
    except OSError:  # another program changed the folder, or Windows keeps the open lock: the content stays
        return


@contextmanager
def hold(path: Path) -> Iterator[None]:
    """Hold the lock file ``path``; raises EnvironmentProblem with the holder's name if another run has it."""
    descriptor = _acquire(path)
    try:
        yield
    finally:
        os.close(descriptor)


def _acquire(path: Path) -> int:
    folder = path.parent.parent
    while True:
        with environment(f"the run folder {folder} cannot be used"):
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            if not _try_lock(descriptor):
                holder = _holder(descriptor)
                os.close(descriptor)
                raise EnvironmentProblem(f"{folder} is in use by another run: {holder}")
            if _is_still_there(descriptor, path):
                _sign(descriptor)
                return descriptor
        os.close(descriptor)  # the previous holder removed the file while it was being opened


def _is_still_there(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False


def _sign(descriptor: int) -> None:
    since = time.strftime("%Y-%m-%d %H:%M:%S")
    note = json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "since": since}).encode()
    os.ftruncate(descriptor, 0)
    os.lseek(descriptor, 0, os.SEEK_SET)
    os.write(descriptor, note)


def _holder(descriptor: int) -> str:
    try:
        note = json.loads(os.read(descriptor, 4096))
        return f"process {note['pid']} on {note['host']}, since {note['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "a process that has just started"


if sys.platform == "win32":
    import msvcrt

    def _try_lock(descriptor: int) -> bool:
        os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        finally:
            os.lseek(descriptor, 0, os.SEEK_SET)
        return True

else:
    import fcntl

    def _try_lock(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
