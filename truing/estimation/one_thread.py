"""Run matrix products on one thread.

Matrices are small here. Threads that share one product wait for each other longer than they compute, tens of times as
long on a busy machine. They also change its last bits.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import TYPE_CHECKING, ParamSpec, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_Given = ParamSpec("_Given")
_Found = TypeVar("_Found")


@cache
def _libraries() -> ThreadpoolController:
    """Return the loaded linear algebra libraries."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def on_one_thread(function: Callable[_Given, _Found]) -> Callable[_Given, _Found]:
    """Return a function whose matrix products use one thread each; other code of the process is not limited."""

    @wraps(function)
    def limited(*given: _Given.args, **named: _Given.kwargs) -> _Found:
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*given, **named)

    return limited
