"""`python -m pipeline` is `truing`."""

from __future__ import annotations

import os
import sys
from contextlib import suppress


def _leave_current_folder() -> None:
    """Take back that `python -m` puts the current folder first on the path: `numpy.py` beside the data is no module."""
    own = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    with suppress(FileNotFoundError):  # the current folder is no more
        if sys.path[0] == os.getcwd() != own:
            del sys.path[0]


_leave_current_folder()

from truing.pipeline.entry import main  # noqa: E402

main()
