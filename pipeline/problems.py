"""Exit codes, and problems of the environment."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum

from truing.schemas.memory import shortage_in_chain


class ExitCode(IntEnum):
    """Exit code for the shell."""

    DONE = 0
    DEFECT = 1
    UNUSABLE_CAMPAIGN = 2
    FAILED_CHECK = 3
    ENVIRONMENT = 4
    KEYBOARD = 130  # Ctrl-C: 128 + SIGINT, as is usual

    @property
    def meaning(self) -> str:
        """Meaning of the code, as the last line of a run gives it."""
        return _MEANING[self]


_MEANING = {
    ExitCode.DONE: "done",
    ExitCode.DEFECT: "truing has a defect",
    ExitCode.UNUSABLE_CAMPAIGN: "the campaign cannot be used",
    ExitCode.FAILED_CHECK: "done, but a quality check failed",
    ExitCode.ENVIRONMENT: "the environment prevented the work",
    ExitCode.KEYBOARD: "ended by Ctrl-C",
}


# With several campaigns, the worst exit code is the call's.
_GRAVITY = (
    *(ExitCode.DONE, ExitCode.FAILED_CHECK, ExitCode.UNUSABLE_CAMPAIGN, ExitCode.ENVIRONMENT),
    *(ExitCode.KEYBOARD, ExitCode.DEFECT),
)


def gravity(code: int) -> int:
    """Rank of an exit code; the worst has the largest."""
    return _GRAVITY.index(ExitCode(code))


def gravest(codes: list[ExitCode]) -> ExitCode:
    """The worst of several exit codes."""
    return max(codes, key=gravity, default=ExitCode.DONE)


class EnvironmentProblem(Exception):
    """Disk, memory, permissions or another run prevented the work; finished artifacts are intact."""


class Defect(Exception):
    """An unexpected error; its traceback is in a log."""


class Interrupted(BaseException):
    """A signal stopped the run (SIGINT or SIGTERM); no ordinary handler may catch it."""


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


# Libraries that only some of the work needs, and how to install each.
_CLUSTER = 'pip install "truing[cluster]"'
_INSTALLED_BY = {
    "cv2": "pip install opencv-contrib-python-headless",
    "dask": _CLUSTER,
    "distributed": _CLUSTER,
}


def environment_problem(error: Exception, doing: str) -> EnvironmentProblem | None:
    """The problem in words if ``error`` comes from the environment, else None."""
    if isinstance(error, ModuleNotFoundError) and error.name in _INSTALLED_BY:
        return EnvironmentProblem(f"{doing}: needs {error.name}, which is not installed; {_INSTALLED_BY[error.name]}")
    if (found := shortage_in_chain(error)) is not None:
        return EnvironmentProblem(f"{doing}: there is not enough memory{_brief(found)}; {_MORE_MEMORY}")
    cause = _CAUSES.get(error.errno or 0) if isinstance(error, OSError) else None
    if not isinstance(error, OSError) or cause is None:
        return None
    file = f" ({os.fsdecode(error.filename)})" if isinstance(error.filename, (str, bytes)) else ""
    return EnvironmentProblem(f"{doing}: {cause}{file}")


def _brief(error: BaseException) -> str:
    """A library's own message about a memory shortage, in brackets; empty if there is none."""
    text = " ".join(str(error).split())[:160]
    return f" ({text})" if text else ""


@contextmanager
def environment(doing: str) -> Iterator[None]:
    """Turn every OSError of a step into an EnvironmentProblem with one sentence."""
    try:
        yield
    except OSError as error:
        known = environment_problem(error, doing)
        file = f" ({os.fsdecode(error.filename)})" if isinstance(error.filename, (str, bytes)) else ""
        raise known or EnvironmentProblem(f"{doing}: {error.strerror or error}{file}") from error
