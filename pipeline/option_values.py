"""Conversion of command line options to values: pairs of numbers, and the workforce of a run."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from truing.pipeline.executor import Workforce


def number_pair(option: str, text: str) -> tuple[float, float]:
    """Two numbers separated by a comma; raises typer.BadParameter."""
    try:
        low, high = (float(word) for word in text.split(","))
    except ValueError:
        raise typer.BadParameter(
            f"{option}: two numbers separated by a comma, such as 500,1500; found {text!r}"
        ) from None
    if not (math.isfinite(low) and math.isfinite(high)):
        raise typer.BadParameter(f"{option}: finite numbers; found {text!r}")
    return low, high


def workforce(workers: int | None, scheduler: str | None) -> Workforce:
    """Workforce by the options; raises typer.BadParameter."""
    from truing.pipeline.executor import LOCAL, Workforce, installed

    if scheduler not in (None, LOCAL) and not re.fullmatch(r"(tcp|tls)://[^/\s]+:\d+", scheduler or ""):
        raise typer.BadParameter(
            f"--scheduler: found {scheduler!r}; expected tcp://host:port, tls://host:port or local"
        )
    requested = Workforce(workers, scheduler)
    if (available := installed(requested)) != requested:
        typer.echo(
            f'Dask is not installed (pip install "truing[cluster]"): {available} of this machine instead', err=True
        )
    return available
