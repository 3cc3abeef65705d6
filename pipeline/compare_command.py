"""`truing compare`: runs of one machine side by side, and which of its numbers have changed."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.problems import ExitCode, environment
from truing.pipeline.recorded import opened_run
from truing.pipeline.voice import Voice
from truing.pipeline.whole_file import write_whole
from truing.pipeline.written_places import check_folder
from truing.schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    from truing.report.comparison.compared_runs import Comparison
    from truing.runs.comparison.side_by_side import SideBySide
    from truing.runs.recorded_run import Run

FOLDER, PAGE = "comparison", "comparison.html"
_MEASURED = ("observations", "readings")
# What the page shows of each run beside its numbers.
_SHOWN = ("qa", "diagnosis", "model_choice", "requirements", "error_classes")


def compare_runs(folders: Sequence[Path], out: Path | None) -> ExitCode:
    """Leave the table and the page of a comparison, and say what has changed. Raises CampaignFaults."""
    from truing.report.comparison.head import comparison_head
    from truing.report.comparison.sections import comparison_sections
    from truing.report.rendering.render import render_page
    from truing.runs.comparison.side_by_side import side_by_side
    from truing.schemas.artifacts import ARTIFACTS

    _distinct(folders)
    place = folders[0].parent / FOLDER if out is None else out
    check_folder(place)
    runs = [_opened(folder) for folder in folders]
    try:
        _of_one_machine(runs)
        _of_own_measurements(runs)
        found = side_by_side(runs)
        shown = _shown(runs, found)
        head = comparison_head(shown)
    except (ValueError, OSError) as broken:  # a file of a run is not what its schema says, or cannot be read
        lines = str(broken).split("\n")
        raise CampaignFaults(Fault("RUN", f"runs that are whole ({line})") for line in lines) from None
    with environment(f"the folder {place} cannot be made"):
        place.mkdir(parents=True, exist_ok=True)
    artifact = ARTIFACTS["compared"]
    _leave_table(place / artifact.file, found, runs)
    write_whole(place / PAGE, render_page(head, comparison_sections(shown)).encode())
    voice = Voice(quiet=False)
    for _, sentence in head.verdicts:
        voice.say(sentence)
    voice.say(f"table and page: {place / artifact.file}, {place / PAGE}")
    return ExitCode.DONE


def _leave_table(path: Path, found: SideBySide, runs: Sequence[Run]) -> None:
    from truing import __version__
    from truing.pipeline.artifacts import Stamp, write_table
    from truing.runs.comparison.side_by_side import compared_table
    from truing.schemas.artifacts import ARTIFACTS

    digest = _digest([run.origin("qa")["digest"] for run in runs])
    campaigns = ", ".join(dict.fromkeys(run.campaign for run in runs))
    stamp = Stamp("compare", digest, campaigns, __version__, ("compared",))
    write_table(path, ARTIFACTS["compared"], compared_table(found), stamp)


def _distinct(folders: Sequence[Path]) -> None:
    """Raise where there are fewer than two runs, or one is named twice."""
    if len(folders) < 2:
        raise CampaignFaults([Fault("RUN", "two runs or more", value=str(folders[0]))])
    twice = [place for place, times in Counter(os.path.realpath(folder) for folder in folders).items() if times > 1]
    if twice:
        raise CampaignFaults(Fault(place, "each run once") for place in twice)


def _opened(folder: Path) -> Run:
    run = opened_run(folder)
    if "qa" not in run:
        raise CampaignFaults([Fault(str(folder), "a folder that `truing run` has filled")])
    return run


def _of_one_machine(runs: Sequence[Run]) -> None:
    """Raise where the runs are of different mechanisms; one without a model may be of any that its tables fit."""
    from truing.runs.comparison.side_by_side import kind_of, mechanism_of

    for told in (kind_of, mechanism_of):
        known = [(run, what) for run in runs if (what := told(run))]
        for run, what in known[1:]:
            if what != known[0][1]:
                expected = f"runs of one machine, as {known[0][0].folder} is: {known[0][1]}"
                raise CampaignFaults([Fault(str(run.folder), expected, value=what)])


def _of_own_measurements(runs: Sequence[Run]) -> None:
    """Raise where two runs are of the same measurements: they agree whatever the machine did."""
    first: dict[str, Run] = {}
    for run in runs:
        for name in _MEASURED:
            if name in run:
                other = first.setdefault(run.origin(name)["digest"], run)
                if other is not run:
                    expected = f"a run of other measurements than {other.folder}"
                    raise CampaignFaults([Fault(str(run.folder), expected)])


def _shown(runs: Sequence[Run], found: SideBySide) -> Comparison:
    from truing.report.comparison.compared_runs import Between, Compared, Comparison

    compared = tuple(
        Compared(
            label,
            str(run.folder),
            run.origin("qa")["software_version"],
            {name: run[name] for name in _SHOWN if name in run},
        )
        for label, run in zip(_labels(runs), runs, strict=True)
    )
    between = tuple(
        Between(tuple(step.why for step in steps if step.why), any(step.rebuilt for step in steps))
        for steps in found.steps
    )
    return Comparison(compared, found.table, between)


def _labels(runs: Sequence[Run]) -> list[str]:
    """What the runs are called: by campaign, by folder, or by the whole path, whichever tells them apart."""
    for names in ([run.campaign for run in runs], [run.folder.name for run in runs]):
        if len(set(names)) == len(runs):
            return names
    return [str(run.folder) for run in runs]


def _digest(parts: Sequence[str]) -> str:
    import hashlib

    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
