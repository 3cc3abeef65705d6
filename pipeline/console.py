"""Output of a run: a progress bar on a terminal, one line per stage elsewhere, nothing if quiet."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from io import StringIO
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

_WIDE = 200  # characters of a table without a terminal


class RunConsole:
    """Output of a run. As a context around one stage, it is that stage's ``progress(done, total, what)``."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet
        self._terminal = not quiet and sys.stdout.isatty()
        self._bar: Bar | None = None
        self._stage = ""

    def line(self, line: str) -> None:
        """Print one line unless quiet."""
        if self._quiet:
            return
        try:
            sys.stdout.write(f"{line}\n")
            sys.stdout.flush()
        except BrokenPipeError:  # the reader of the output has ended; the run continues
            self._quiet = True
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def show(self, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print a table, as wide as the terminal, or as needed without one."""
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        table = Table(*heads, box=None, pad_edge=False, header_style="bold")
        for row in rows:
            table.add_row(*map(Text, row))
        console = Console(file=StringIO(), width=None if self._terminal else _WIDE, color_system=None)
        with console.capture() as captured:
            console.print(table)
        for line in captured.get().splitlines():
            self.line(line.rstrip())

    def warn(self, line: str) -> None:
        """Print one line on stderr, even if quiet."""
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()

    def during(self, stage: str) -> RunConsole:
        """This console, for the messages of one stage."""
        self._stage = stage
        return self

    def __enter__(self) -> RunConsole:
        if self._terminal:
            self._bar = _bar()
            self._bar.add_task(self._stage, total=None)
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def __call__(self, done: int, total: int, what: str) -> None:
        """Show the progress of the stage on a terminal: ``done`` of ``total`` (0: unknown), working on ``what``."""
        if self._bar is not None:
            task = self._bar.task_ids[0]
            self._bar.update(task, completed=done, total=total or None, description=f"{self._stage}: {what}")


class Recorder(RunConsole):
    """Collects output without a terminal, to be repeated later; each line with whether it is a warning."""

    def __init__(self) -> None:
        super().__init__(quiet=True)
        self.lines: list[tuple[bool, str]] = []

    def line(self, line: str) -> None:
        """Collect one line."""
        self.lines.append((False, line))

    def warn(self, line: str) -> None:
        """Collect one warning."""
        self.lines.append((True, line))

    def __call__(self, done: int, total: int, what: str) -> None:
        """Ignore progress."""


def _bar() -> Bar:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, transient=True)
