"""Outcome of one campaign of a call: exit code, verdicts and messages."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from truing.pipeline.console import Recorder, RunConsole
from truing.pipeline.exit_status import end
from truing.pipeline.problems import ExitCode


@dataclass(frozen=True)
class CampaignOutcome:
    """Exit code of a campaign, messages (each with whether it is a warning), facts by kind, and processor time in s."""

    code: ExitCode
    lines: tuple[tuple[bool, str], ...] = ()
    facts: tuple[tuple[str, Mapping[str, Any]], ...] = ()
    processor_s: float = 0.0

    @property
    def problems(self) -> tuple[str, ...]:
        """Faults and other problems, one line each."""
        return tuple(line for warns, line in self.lines if warns)

    def repeat(self, console: RunConsole) -> None:
        """Print the collected messages, and report the facts."""
        for kind, fact in self.facts:
            console.add_fact(kind, fact)
        for warns, line in self.lines:
            (console.warn if warns else console.line)(line)


def outcome_of(action: Callable[[Recorder], ExitCode], recorder: Recorder) -> CampaignOutcome:
    """Call an action, and collect its messages, facts and processor time; interruptions pass."""
    begun = time.process_time()
    code = end(lambda: action(recorder), recorder)
    return CampaignOutcome(code, tuple(recorder.lines), tuple(recorder.facts), time.process_time() - begun)
