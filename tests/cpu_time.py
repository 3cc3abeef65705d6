"""Measure the processor time of tests and fixtures in all workers, and print the largest consumers at the end."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

_LEAST_REPORTED_S = 30.0  # a run of a few files needs no table
_LISTED = 12
_OUTPUT = "cpu_time"
_OUTSIDE = "start, collection and end"


def processor_seconds() -> float:
    """Return the time that this process and its ended children spent on a processor."""
    return sum(os.times()[:4])


def folder_of(node: str) -> str:
    """Return the folder of a test below ``tests``, for `tests/stages/sensor/test_run.py::test_a` ``stages/sensor``."""
    parts = node.partition("::")[0].split("/")[1:-1]
    return "/".join(parts[:2]) or "tests"


class CpuTime:
    """A pytest plugin with processor seconds by folder, by test, and by fixture of more than one test."""

    def __init__(self) -> None:
        self.folders: Counter[str] = Counter()
        self.tests: Counter[str] = Counter()
        self.fixtures: Counter[str] = Counter()
        self.made: Counter[str] = Counter()  # how many times, in all workers
        self._own = 0.0  # seconds of tests in this process

    @contextmanager
    def _measured(self, *places: tuple[Counter[str], str]) -> Iterator[None]:
        before = processor_seconds()
        yield
        spent = processor_seconds() - before
        for counter, name in places:
            counter[name] += spent  # type: ignore[assignment]

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        before = self.tests[item.nodeid]
        with self._measured((self.folders, folder_of(item.nodeid)), (self.tests, item.nodeid)):
            result = yield
        self._own += self.tests[item.nodeid] - before
        return result

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        name = f"{fixturedef.argname} of {fixturedef.baseid or 'pytest'}"
        self.made[name] += 1
        with self._measured((self.fixtures, name)):
            return (yield)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Add what no test took; a worker of xdist hands its counts to the process that started it."""
        self.folders[_OUTSIDE] += processor_seconds() - self._own  # type: ignore[assignment]
        output = getattr(session.config, "workeroutput", None)
        if output is not None:
            slowest = dict(self.tests.most_common(_LISTED))
            output[_OUTPUT] = [dict(self.folders), slowest, dict(self.fixtures), dict(self.made)]

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take a worker's counts; one that crashed has none."""
        counts = getattr(node, "workeroutput", {}).get(_OUTPUT, ())
        for own, theirs in zip((self.folders, self.tests, self.fixtures, self.made), counts, strict=False):
            own.update(theirs)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        whole = sum(self.folders.values())
        if whole < _LEAST_REPORTED_S:
            return
        terminalreporter.write_sep("=", f"processor time: {whole / 60:.1f} min")
        _write(terminalreporter, "by folder", self.folders.most_common(), whole)
        _write(terminalreporter, "slowest tests", self.tests.most_common(_LISTED), whole)
        fixtures = [(f"{name}, made {self.made[name]}x", s) for name, s in self.fixtures.most_common(_LISTED)]
        _write(terminalreporter, "slowest fixtures", fixtures, whole)


def _write(terminal: pytest.TerminalReporter, title: str, rows: list[tuple[str, float]], whole: float) -> None:
    terminal.write_line(f"{title}:")
    for name, seconds in rows:
        terminal.write_line(f"  {seconds:7.1f} s {100.0 * seconds / whole:5.1f} %  {name}")
