"""Options and arguments that several commands take, and how their words are read."""

from __future__ import annotations

import math
import re
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from truing.pipeline.workforce import Workforce


class QaGate(StrEnum):
    """What a failed QA check does to the exit code."""

    WARN = "warn"
    FAIL = "fail"


class Method(StrEnum):
    """How `design` searches."""

    EXCHANGE = "exchange"
    DIRECT = "direct"
    IOOPS = "ioops"
    RANDOM = "random"


class Within(StrEnum):
    """What limits the configurations that `design` may choose."""

    WORKSPACE = "workspace"
    ACTUATORS = "actuators"


Campaigns = Annotated[list[Path], typer.Argument(metavar="CAMPAIGN", help="Folders that hold a campaign.toml.")]
OneCampaign = Annotated[Path, typer.Argument(metavar="CAMPAIGN", help="A folder that holds a campaign.toml.")]
Out = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="The run's folder; default: runs/<campaign name>.")
]
Gate = Annotated[QaGate, typer.Option("--qa", help="Whether a failed check is exit code 3 or only told.")]
Anew = Annotated[bool, typer.Option("--check", help="Read every file anew instead of trusting size, time and inode.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Say only what went wrong.")]
Workers = Annotated[
    int | None, typer.Option("--workers", min=1, max=1000, metavar="N", help="Do so many at a time, each in a process.")
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, tcp://host:port; local: one for this call."),
]


def pair(option: str, text: str) -> tuple[float, float]:
    """Two numbers by a comma; raises typer.BadParameter."""
    try:
        low, high = (float(word) for word in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{option}: two numbers by a comma, as 500,1500; found {text!r}") from None
    if not (math.isfinite(low) and math.isfinite(high)):
        raise typer.BadParameter(f"{option}: finite numbers; found {text!r}")
    return low, high


def workforce(workers: int | None, scheduler: str | None) -> Workforce:
    """Who does the work, from the options; raises typer.BadParameter."""
    from truing.pipeline.workforce import LOCAL, Workforce

    if scheduler not in (None, LOCAL) and not re.fullmatch(r"(tcp|tls)://[^/\s]+:\d+", scheduler or ""):
        raise typer.BadParameter(
            f"--scheduler: found {scheduler!r}; expected tcp://host:port, tls://host:port or local"
        )
    return Workforce(workers, scheduler)
