"""`python -m truing.pipeline`: same as `truing` and `python -m truing`."""

from __future__ import annotations

import os
import sys
from contextlib import suppress


def _leave_current_folder() -> None:
    """Remove the current folder from the import path, so that a `numpy.py` next to the data is not imported."""
    project = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    with suppress(FileNotFoundError):  # the current folder was deleted
        if sys.path[0] == os.getcwd() != project:
            del sys.path[0]


_leave_current_folder()

from truing.pipeline.entry import main  # noqa: E402

main()
