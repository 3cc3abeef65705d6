"""Output of a run: a progress bar on a terminal, one line per stage elsewhere, nothing if quiet, or JSON."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from io import StringIO
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from rich.progress import Progress as Bar

    from truing.pipeline.problems import ExitCode

_WIDE = 200  # characters of a table without a terminal


class RunConsole:
    """Output of a run. As a context around one stage, it is that stage's ``progress(done, total, what)``."""

    def __init__(self, *, quiet: bool, verbose: bool = False) -> None:
        self._quiet = quiet
        self._verbose = verbose
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

    def detail(self, line: str) -> None:
        """Print one line if verbose."""
        if self._verbose:
            self.line(line)

    def add_fact(self, kind: str, fact: Mapping[str, object]) -> None:
        """Add a fact to the JSON output; other outputs print it as a line."""

    def sentence(self, sentence: str) -> None:
        """Print a sentence on a result, which JSON holds among ``sentences``."""
        self.line(sentence)
        self.add_fact("sentences", {"sentence": sentence})

    def aside(self, sentence: str) -> None:
        """Print a sentence beside a table on standard output, unless quiet."""
        if not self._quiet:
            sys.stderr.write(f"{sentence}\n")

    def written(self, words: str, files: Sequence[Path]) -> None:
        """Print which files were written; JSON holds their paths among ``files``."""
        self.line(words)
        for file in files:
            self.add_fact("files", {"file": str(file)})

    def close(self, code: ExitCode) -> None:
        """Print the closing lines; here nothing."""

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


class JsonConsole(RunConsole):
    """Prints one JSON object at the end: the exit code, its meaning, and a list of facts of each kind."""

    def __init__(self) -> None:
        super().__init__(quiet=True)
        self._facts: dict[str, list[object]] = {}

    def add_fact(self, kind: str, fact: Mapping[str, object]) -> None:
        """Keep a fact for the end."""
        self._facts.setdefault(kind, []).append(_plain(fact))

    def warn(self, line: str) -> None:
        """Print one line on stderr, and keep it."""
        super().warn(line)
        self._facts.setdefault("messages", []).append(line)

    def close(self, code: ExitCode) -> None:
        """Print the object."""
        self._quiet = False
        document = {"exit_code": int(code), "meaning": code.meaning, **self._facts}
        self.line(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False, default=str))


def _plain(value: object) -> object:
    """A value without numbers that JSON lacks; they become null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, (list, tuple)) else value


class Recorder(RunConsole):
    """Collects output without a terminal, to be repeated later; each line with whether it is a warning."""

    def __init__(self, *, verbose: bool = False) -> None:
        super().__init__(quiet=True, verbose=verbose)
        self.lines: list[tuple[bool, str]] = []
        self.facts: list[tuple[str, Mapping[str, object]]] = []

    def add_fact(self, kind: str, fact: Mapping[str, object]) -> None:
        """Collect one fact."""
        self.facts.append((kind, fact))

    def line(self, line: str) -> None:
        """Collect one line."""
        self.lines.append((False, line))

    def warn(self, line: str) -> None:
        """Collect one warning."""
        self.lines.append((True, line))

    def __call__(self, done: int, total: int, what: str) -> None:
        """Ignore progress."""


class Witness(Recorder):
    """Passes output on to another console, and collects it."""

    def __init__(self, shown: RunConsole) -> None:
        super().__init__()
        self._shown = shown

    def add_fact(self, kind: str, fact: Mapping[str, object]) -> None:
        """Collect one fact, and output it."""
        super().add_fact(kind, fact)
        self._shown.add_fact(kind, fact)

    def line(self, line: str) -> None:
        """Collect one line, and print it."""
        super().line(line)
        self._shown.line(line)

    def detail(self, line: str) -> None:
        """Print one line if verbose."""
        self._shown.detail(line)

    def warn(self, line: str) -> None:
        """Collect one warning, and print it."""
        super().warn(line)
        self._shown.warn(line)

    def during(self, stage: str) -> RunConsole:
        """The other console, for the messages of one stage."""
        return self._shown.during(stage)


def _bar() -> Bar:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, TextColumn("left"), TimeRemainingColumn(), transient=True)
