"""Starting further Python processes, which import modules from where this one does and from nowhere else."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_SAFE_PATH = "PYTHONSAFEPATH"


@contextmanager
def safe_children() -> Iterator[None]:
    """Keep the current folder out of the import path of every Python process that is started meanwhile.

    Python puts the current folder first on the path of what `python -c` runs, which is how the standard library starts
    its workers. A file `multiprocessing.py` that lies beside the data would be run as code. Libraries that start
    processes themselves pass the environment on, so this holds for theirs, too.
    """
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(_SAFE_PATH, None)
        else:
            os.environ[_SAFE_PATH] = before


def child_environment() -> dict[str, str]:
    """Return the environment for a child that finds the modules of this process, and none in the current folder."""
    path = [folder for folder in sys.path if folder]  # an empty entry means the current folder
    return {**os.environ, _SAFE_PATH: "1", "PYTHONPATH": os.pathsep.join(path)}
