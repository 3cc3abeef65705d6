"""Create shared test data once, in the worker that needs it first."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from truing.pipeline.problems import EnvironmentProblem
from truing.pipeline.run_folder import hold

_WORKER_ASKS_AGAIN_S = 0.1


def made_once(temporary: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """A folder that all workers share, filled by ``make``; who comes second waits for who came first."""
    own = temporary.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    place, whole = shared / name, shared / f"{name}.whole"
    place.mkdir(exist_ok=True)
    while not whole.exists():
        try:
            with hold(shared / f"{name}.lock"):
                if not whole.exists():
                    make(place)
                    whole.touch()
        except EnvironmentProblem:
            time.sleep(_WORKER_ASKS_AGAIN_S)
    return place
