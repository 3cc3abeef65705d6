"""The folder of one run: entered under its lock, swept of what dead runs left, never left half made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from truing.pipeline.lock import hold
from truing.pipeline.problems import environment
from truing.pipeline.whole_file import PART, part_of
from truing.schemas.artifacts import ARTIFACTS

PRIVATE = ".truing"  # ledger, remembered digests and lock; deleting it loses no result


@contextmanager
def occupied(folder: Path) -> Iterator[Path]:
    """The run folder, created where needed and ours alone; one that received nothing vanishes again."""
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
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    with environment(f"the run folder {folder.parent} cannot be made"):
        folder.mkdir(parents=True, exist_ok=True)
    return missing


def _sweep(folder: Path) -> None:
    with environment(f"the run folder {folder} cannot be tidied"):
        own = [part_of(folder / artifact.file) for artifact in ARTIFACTS.values()]
        for leftover in (*own, *(folder / PRIVATE).glob(f".*{PART}")):
            leftover.unlink(missing_ok=True)


def _remove_empty(lock: Path, created: list[Path]) -> None:
    try:
        if not created or any(entry != lock for entry in lock.parent.iterdir()):
            return
        lock.unlink()
        for place in created:
            place.rmdir()
    except OSError:  # somebody put something there or took it away, or Windows keeps the open lock: what is there stays
        return
