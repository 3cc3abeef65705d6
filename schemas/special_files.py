"""Files that only look like regular ones: entries of /proc and /sys, whose content the system makes up when asked."""

from __future__ import annotations

import os
from pathlib import Path

_OF_THE_SYSTEM = ("/proc", "/sys", "/dev")
_OF_MEMORY = "/dev/shm"  # where ordinary files lie, too
NOTHING_SPECIAL = "no folder, pipe or device, and nothing of /proc, /sys or /dev"


def is_special(path: Path) -> bool:
    """Return whether a path leads, also through links, to what the system makes up; raises OSError.

    Such a file may hold secrets of the process that reads it, or block who reads it for ever.
    """
    real = os.path.realpath(path)
    if any(real == place or real.startswith(f"{place}/") for place in _OF_THE_SYSTEM):
        return not real.startswith(f"{_OF_MEMORY}/")
    status = os.stat(real)
    if status.st_dev in _devices():
        return True
    if status.st_size:
        return False
    try:
        with open(real, "rb") as file:  # such as another mount of /proc: empty files that hold something
            return file.read(1) != b""
    except PermissionError:
        return False


def _devices() -> set[int]:
    """The devices that /proc and /sys are, as far as they are there and none of the disk's."""
    return {os.stat(place).st_dev for place in _OF_THE_SYSTEM[:2] if os.path.ismount(place)}
