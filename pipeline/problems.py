"""How a run may end: exit codes, and what the environment can do to it."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum

from truing.schemas.memory import shortage


class ExitCode(IntEnum):
    """What the shell is told."""

    DONE = 0
    DEFECT = 1
    UNUSABLE_CAMPAIGN = 2
    FAILED_CHECK = 3
    ENVIRONMENT = 4
    KEYBOARD = 130  # Ctrl-C: 128 + SIGINT, as shells expect it


# Of several campaigns in one call the gravest ending is the call's.
_GRAVITY = (
    *(ExitCode.DONE, ExitCode.FAILED_CHECK, ExitCode.UNUSABLE_CAMPAIGN, ExitCode.ENVIRONMENT),
    *(ExitCode.KEYBOARD, ExitCode.DEFECT),
)


def gravest(codes: list[ExitCode]) -> ExitCode:
    """The worst of several endings."""
    return max(codes, key=_GRAVITY.index, default=ExitCode.DONE)


class EnvironmentProblem(Exception):
    """Disk, memory, permissions or another run prevented the work; finished artifacts are intact."""


class Defect(Exception):
    """Something that must not happen did; its traceback is in a log already."""


class Interrupted(BaseException):
    """The run was asked to stop (SIGINT or SIGTERM); no ordinary handler may swallow it."""


_MORE_MEMORY = "run it where there is more, or raise its limit (ulimit -v)"
_CAUSES = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file grew beyond what this system or its limits allow",
    errno.EROFS: "the file system is read-only",
    errno.EACCES: "permission is denied",
    errno.EPERM: "the operation is not permitted",
    errno.EIO: "the device reports an input/output error",
    errno.EMFILE: "too many files are open",
    errno.ENFILE: "too many files are open on this system",
    errno.ENOMEM: "there is not enough memory",
    errno.ENAMETOOLONG: "the path is too long for this file system",
}


def environment_problem(error: Exception, doing: str) -> EnvironmentProblem | None:
    """The problem in words where the environment is to blame for ``error``, else None."""
    if (found := shortage(error)) is not None:
        return EnvironmentProblem(f"{doing}: there is not enough memory{_brief(found)}; {_MORE_MEMORY}")
    cause = _CAUSES.get(error.errno or 0) if isinstance(error, OSError) else None
    if not isinstance(error, OSError) or cause is None:
        return None
    place = f" ({os.fsdecode(error.filename)})" if isinstance(error.filename, (str, bytes)) else ""
    return EnvironmentProblem(f"{doing}: {cause}{place}")


def _brief(error: BaseException) -> str:
    """What a library says of the memory that it lacks, as how much it wanted; empty where it says nothing."""
    text = " ".join(str(error).split())[:160]
    return f" ({text})" if text else ""


@contextmanager
def environment(doing: str) -> Iterator[None]:
    """Turn every OSError of a step in which only the environment can fail into a sentence."""
    try:
        yield
    except OSError as error:
        known = environment_problem(error, doing)
        place = f" ({os.fsdecode(error.filename)})" if isinstance(error.filename, (str, bytes)) else ""
        raise known or EnvironmentProblem(f"{doing}: {error.strerror or error}{place}") from error
