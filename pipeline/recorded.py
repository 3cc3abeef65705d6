"""A run's folder, opened by the commands that read what a run has left: whole, of one piece, and as it was written."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.ledger import Ledger, read_ledger
from truing.pipeline.remembered import RememberedDigests
from truing.pipeline.run_folder import PRIVATE
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    from truing.runs.recorded_run import Run

_PAGE = ARTIFACTS["report"].file
_AGAIN = "`truing run` makes it again"


def opened_run(folder: Path) -> Run:
    """Open a run; raises CampaignFaults where there is none, or where it is not what its stages have left together."""
    from truing.runs.recorded_run import load

    try:
        run = load(folder)
    except (FileNotFoundError, NotADirectoryError):
        raise CampaignFaults([Fault(str(folder), "a folder that `truing run` has filled")]) from None
    except ValueError as broken:
        raise CampaignFaults(broken_run(folder, broken)) from None
    ledger = read_ledger(folder / PRIVATE / "ledger.json")  # empty where somebody has copied the tables alone
    if faults := [*_changed(folder, ledger), *_mixed(folder, ledger)]:
        raise CampaignFaults(faults)
    try:
        run.model  # noqa: B018 (read once, here, so that its faults are the run's)
    except (OSError, ValueError, RecursionError):
        raise CampaignFaults([Fault(str(folder), "a model.toml that `truing run` has written")]) from None
    return run


def broken_run(folder: Path, broken: Exception) -> list[Fault]:
    """The faults of a run of which a file is not what its schema says, or cannot be read: a line each."""
    return [Fault(str(folder), f"a run that is whole ({line})") for line in str(broken).split("\n")]


def _changed(folder: Path, ledger: Ledger) -> Iterator[Fault]:
    """A fault per file that is no longer what its stage has written."""
    digests = RememberedDigests(None)
    for entry in ledger.entries.values():
        for name, digest in entry.artifacts.items():
            file = ARTIFACTS[name].file if name in ARTIFACTS else _PAGE
            try:
                if file != _PAGE and digests.digest(folder / file) != digest:
                    yield Fault(str(folder / file), f"the file as its stage has written it; {_AGAIN}")
            except FileNotFoundError:
                yield Fault(str(folder / file), f"this file, which its stage has written; {_AGAIN}")


def _mixed(folder: Path, ledger: Ledger) -> Iterator[Fault]:
    """A fault per stage that was made from other tables than lie there now: a run that did not come to its end."""
    there = {name: digest for entry in ledger.entries.values() for name, digest in entry.artifacts.items()}
    for stage, entry in ledger.entries.items():
        inputs = {} if entry.made_from is None else entry.made_from.inputs
        if any(there.get(name) != digest for name, digest in inputs.items()):
            yield Fault(str(folder), f"a run of one piece; {stage} was made from other tables than these, {_AGAIN}")
