"""The memory that this process may use: too little is said at the door, where libraries would end it without a word."""

from __future__ import annotations

from pipeline.problems import EnvironmentProblem

# Address space in MB: loading the libraries takes 1600, the sample campaign 2100 (two processors). With less, OpenBLAS
# ends the process or waits without end, and the system's loader aborts it.
_LEAST_MB = 2000


def limit_mb() -> float | None:
    """The address space that this process may use (ulimit -v); None where it has no limit, or the system knows none."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if most == resource.RLIM_INFINITY else most / 2**20


def check_memory_limit() -> None:
    """Raise EnvironmentProblem where the limit is below what loading the libraries needs."""
    most = limit_mb()
    if most is not None and most < _LEAST_MB:
        least = f"at least {_LEAST_MB} MB are needed to load the libraries"
        raise EnvironmentProblem(f"this process may use {most:.0f} MB of memory; {least}: raise the limit (ulimit -v)")
