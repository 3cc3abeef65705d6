"""Starting child Python processes that import modules only from where this process does."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_SAFE_PATH = "PYTHONSAFEPATH"


@contextmanager
def safe_children() -> Iterator[None]:
    """Keep the current folder out of the import path of every Python process started inside the context.

    `python -c` puts the current folder first on the path, and the standard library starts its workers this way: a file
    `multiprocessing.py` next to the data would be run as code. Libraries that start processes pass the environment on,
    so this covers them too.
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
    """Return an environment in which a child imports the modules of this process, and none from the current folder."""
    path = [folder for folder in sys.path if folder]  # an empty entry means the current folder
    return {**os.environ, _SAFE_PATH: "1", "PYTHONPATH": os.pathsep.join(path)}
