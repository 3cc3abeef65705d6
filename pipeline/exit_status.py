"""From an action to its exit code; every problem is reported in one sentence."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from truing.pipeline.console import RunConsole
from truing.pipeline.interruption import exit_code_of, interruptible, mark_answered, raise_if_interrupted
from truing.pipeline.problems import (
    Defect,
    EnvironmentProblem,
    ExitCode,
    Interrupted,
    environment_problem,
    gravest,
)
from truing.schemas.faults import CampaignFaults, first_line
from truing.schemas.memory import shortage_in_chain

KEPT = "finished artifacts are intact; run again to resume"
# Address space in MB: loading the libraries takes 1600, the sample campaign 2100 (two processors). With less, OpenBLAS
# ends the process or waits without end, and the system's loader aborts it.
_LEAST_MB = 2000


def end(action: Callable[[], ExitCode], console: RunConsole) -> ExitCode:
    """Exit code of an action, with problems reported on stderr; interruptions pass, because they end the whole call."""
    try:
        with raise_if_interrupted():
            _check_memory_limit()
            return action()
    except CampaignFaults as error:
        if shortage_in_chain(error) is not None:  # a memory shortage is no fault of the campaign
            return _end_of(error, console)
        for line in dict.fromkeys(map(str, error.faults)):
            console.warn(" ".join(line.split("\n")))
        for fault in dict.fromkeys(error.faults):
            console.add_fact("faults", fault.facts())
        return ExitCode.UNUSABLE_CAMPAIGN
    except EnvironmentProblem as error:
        console.warn(f"{error}; {KEPT}")
        return ExitCode.ENVIRONMENT
    except Defect as error:
        console.warn(str(error))
        return ExitCode.DEFECT
    except Exception as error:
        return _end_of(error, console)


def _end_of(error: Exception, console: RunConsole) -> ExitCode:
    known = environment_problem(error, "the work could not be done")
    if known is not None:
        console.warn(f"{known}; {KEPT}")
        return ExitCode.ENVIRONMENT
    console.warn("".join(traceback.format_exception(error)))
    console.warn(f"truing has a defect: {type(error).__name__}: {error}")
    return ExitCode.DEFECT


def end_all(actions: list[Callable[[], ExitCode]], console: RunConsole) -> ExitCode:
    """Run several actions in turn; the worst exit code is the call's, and an interruption ends them all."""
    try:
        with interruptible():
            return gravest([end(action, console) for action in actions])
    except Interrupted as error:
        return end_interrupted(error, console)


def end_interrupted(error: Interrupted, console: RunConsole) -> ExitCode:
    """Exit code of a call ended by a signal, reported on stderr."""
    mark_answered()
    console.warn(f"interrupted ({error}); {KEPT}")
    return exit_code_of(str(error))


@contextmanager
def defects_logged(log: Path, doing: str) -> Iterator[None]:
    """Turn unexpected errors into a Defect with the traceback in ``log``, or into an EnvironmentProblem."""
    try:
        with raise_if_interrupted():
            yield
    except (CampaignFaults, EnvironmentProblem, Defect):
        raise
    except Exception as error:
        known = environment_problem(error, doing)
        if known is not None:
            raise known from error
        try:
            log.write_text("".join(traceback.format_exception(error)), encoding="utf-8")
        except OSError:
            if not log.parent.is_dir():
                raise EnvironmentProblem(f"{doing}: the folder {log.parent} has disappeared") from error
            raise error from None
        brief = first_line(error)[:200]
        sentence = f"truing has a defect: {doing} ended with {type(error).__name__}: {brief} (traceback in {log})"
        raise Defect(sentence) from error


def _limit_mb() -> float | None:
    """Address space limit of this process (ulimit -v); None if there is none or it is unknown."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if most == resource.RLIM_INFINITY else most / 2**20


def _check_memory_limit() -> None:
    """Raise EnvironmentProblem if the limit is too low for loading the libraries."""
    most = _limit_mb()
    if most is not None and most < _LEAST_MB:
        least = f"at least {_LEAST_MB} MB are needed to load the libraries"
        raise EnvironmentProblem(f"this process may use {most:.0f} MB of memory; {least}: raise the limit (ulimit -v)")
