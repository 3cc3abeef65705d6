"""Recognition of memory shortages in the errors of libraries."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator

# Messages of memory shortages without an error type: the system's loader, threads of Python and of Arrow.
_SAID = re.compile(
    r"failed to map segment|cannot allocate memory|can't start new thread|failed to launch worker thread"
    r"|bad_alloc|static TLS block|unable to allocate|out of memory",
    re.IGNORECASE,
)
_ASKED = re.compile(r"alloc of size (\d+) failed")  # Arrow
_MOST = 1 << 40  # bytes; a damaged file may request more, which is no memory shortage
# The interpreter itself, where it finds no memory for the MemoryError.
_LOST = re.compile(r"without (setting an exception|exception set)")
_TELLING = (ImportError, RuntimeError, SystemError)


def shortage_in_chain(error: BaseException) -> BaseException | None:
    """The first error in the chain of causes that reports a memory shortage; None if there is none."""
    return next(filter(_is_shortage, _chain(error)), None)


def raise_shortage(error: BaseException) -> None:
    """Raise MemoryError if an error comes from a memory shortage, so that the file does not count as damaged."""
    if (found := shortage_in_chain(error)) is not None:
        raise MemoryError(str(found)) from error


def _is_shortage(error: BaseException) -> bool:
    if isinstance(error, MemoryError):
        asked = _ASKED.search(str(error))
        return asked is None or int(asked[1]) < _MOST
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    if isinstance(error, SystemError) and _LOST.search(str(error)):
        return True
    from_arrow = type(error).__module__.startswith("pyarrow")
    return (from_arrow or isinstance(error, _TELLING)) and bool(_SAID.search(str(error)))


def _chain(error: BaseException) -> Iterator[BaseException]:
    """An error and all errors in whose handling it was raised, suppressed ones included."""
    seen: set[int] = set()
    waiting: list[BaseException | None] = [error]
    while waiting:
        one = waiting.pop()
        if one is not None and id(one) not in seen:
            seen.add(id(one))
            yield one
            waiting += [one.__context__, one.__cause__]
