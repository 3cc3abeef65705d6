"""Want of memory, by whatever error a library tells of it."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator

# What libraries say, in errors that have no type of their own: the loader of the system, Python's and Arrow's threads.
_SAID = re.compile(
    r"failed to map segment|cannot allocate memory|can't start new thread|failed to launch worker thread"
    r"|bad_alloc|static TLS block|unable to allocate|out of memory",
    re.IGNORECASE,
)
_ASKED = re.compile(r"alloc of size (\d+) failed")  # Arrow
_MOST = 1 << 40  # bytes: a damaged file asks for more, which is no want of memory
_TELLING = (ImportError, RuntimeError, SystemError)


def shortage(error: BaseException) -> BaseException | None:
    """The error that tells of a want of memory, among one and those that it came from; None where none does."""
    return next(filter(_is_shortage, _chain(error)), None)


def raise_shortage(error: BaseException) -> None:
    """Raise MemoryError where an error comes from a want of memory: what could not be read for it is not broken."""
    if (found := shortage(error)) is not None:
        raise MemoryError(str(found)) from error


def _is_shortage(error: BaseException) -> bool:
    if isinstance(error, MemoryError):
        asked = _ASKED.search(str(error))
        return asked is None or int(asked[1]) < _MOST
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    from_arrow = type(error).__module__.startswith("pyarrow")
    return (from_arrow or isinstance(error, _TELLING)) and bool(_SAID.search(str(error)))


def _chain(error: BaseException) -> Iterator[BaseException]:
    """An error, and those in whose handling it was raised, also where they are not shown."""
    seen: set[int] = set()
    waiting: list[BaseException | None] = [error]
    while waiting:
        one = waiting.pop()
        if one is not None and id(one) not in seen:
            seen.add(id(one))
            yield one
            waiting += [one.__context__, one.__cause__]
