"""`truing watch`: runs a campaign again whenever its files change, and reports whether the measurements are enough."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from pathlib import Path

import pandas as pd

from truing.estimation.repeated_looks import Look, counted_looks, is_decided, next_count
from truing.formats.source import raw_files
from truing.pipeline.artifacts import table_of
from truing.pipeline.atomic_file import write_atomically
from truing.pipeline.campaign_folder import CampaignFolder, run_folder_of, suggested_folder
from truing.pipeline.console import Recorder, RunConsole
from truing.pipeline.executor import processors
from truing.pipeline.exit_status import end
from truing.pipeline.problems import ExitCode
from truing.pipeline.run_campaign import RunOptions, run_campaign, usable_campaign
from truing.pipeline.run_folder import PRIVATE
from truing.pipeline.watch_page import WatchServer, serving
from truing.report.watching import Enough, Watched, requirement_look, watched
from truing.schemas.faults import CampaignFaults, Fault

_LOOKS = "looks.json"
_TABLES = (
    "verdict",
    "requirements",
    "model_choice",
    "joints",
    "axis_errors",
    "next_measurements",
    "configurations",
    "observations",
    "residuals",
    "readings",
    "signals",
)

Snapshot = Mapping[str, tuple[int, int]]  # size and time of change of each file


@dataclass(frozen=True)
class WatchOptions:
    """Seconds between two looks, whether to end after one round, and whether rounds are lines of JSON.

    ``port`` of the page; None: the usual one or any free one. ``has_page``: whether there is a page.
    """

    interval_s: float = 2.0
    once: bool = False
    as_json: bool = False
    port: int | None = None
    has_page: bool = True


@dataclass
class _Watch:
    """A watched campaign: its folder, its run folder where known, and the last round."""

    place: Path
    out: Path | None
    number: int = 0
    state: Watched | None = None
    code: ExitCode = ExitCode.DONE
    lines: tuple[str, ...] = ()  # what the stages of the last round did
    options: RunOptions = field(default_factory=lambda: RunOptions(workers=processors()))

    @property
    def campaign(self) -> CampaignFolder | None:
        """The campaign on disk; None as long as its campaign.toml cannot be used."""
        try:
            return usable_campaign(self.place)
        except CampaignFaults:
            return None

    @property
    def run(self) -> Path | None:
        """Folder of the run; None as long as campaign.toml does not name it."""
        campaign = self.campaign
        return self.out if campaign is None else run_folder_of(campaign, self.out, several=False)

    def round(self) -> Watched:
        """Bring the campaign up to date, and return its present results."""
        self.number += 1
        recorder = Recorder()
        self.code = end(lambda: self._run(recorder), recorder)
        self.lines = tuple(line for is_warning, line in recorder.lines if not is_warning)
        unusable = self.code not in (ExitCode.DONE, ExitCode.FAILED_CHECK)
        faults = tuple(line for is_warning, line in recorder.lines if is_warning) if unusable else ()
        run = self.run
        tables = {} if faults or run is None else _tables(run)
        state = watched(self.place.resolve().name, self.number, datetime.now(), tables, faults)
        if run is not None and (found := requirement_look(tables)) is not None:
            counted = self._counted(run, Look(found.poses, found.decision, found.p_value))
            state = replace(state, is_confirmed=is_decided(counted), poses_to_confirm=next_count(counted))
        self.state = state
        return state

    def _counted(self, run: Path, look: Look) -> list[Look]:
        """The looks so far with this one; they are stored next to the run, so that a restarted watch continues to
        count."""
        kept_looks = _KeptLooks(run / PRIVATE / _LOOKS, self._asked())
        # With fewer poses than before, poses were taken out: what was seen with them counts no more.
        counted = counted_looks([*(one for one in kept_looks.read() if one.count <= look.count), look])
        kept_looks.write(counted)
        return counted

    def _asked(self) -> object:
        """The settings of [requirement]: looks at other requirements do not count."""
        campaign = self.campaign
        return None if campaign is None else campaign.section("requirement")

    def _run(self, console: RunConsole) -> ExitCode:
        campaign = usable_campaign(self.place)
        return run_campaign(campaign, run_folder_of(campaign, self.out, several=False), self.options, console)


@dataclass(frozen=True)
class _KeptLooks:
    """Looks at the requirements of a run, in a file, so that a restarted watch continues to count."""

    file: Path
    asked: object

    def read(self) -> tuple[Look, ...]:
        """Return the looks; none if the file is missing, damaged, or about other requirements."""
        try:
            stored = json.loads(self.file.read_text(encoding="utf-8"))
            found = tuple(
                Look(int(one["count"]), str(one["decision"]), float(one["p_value"])) for one in stored["looks"]
            )
            return found if stored["requirement"] == self.asked else ()
        except (OSError, ValueError, KeyError, TypeError):
            return ()

    def write(self, looks: Sequence[Look]) -> None:
        """Keep these looks instead."""
        stored = {"requirement": self.asked, "looks": [asdict(look) for look in looks]}
        write_atomically(self.file, json.dumps(stored).encode())


def watch_campaign(path: Path, out: Path | None, options: WatchOptions, console: RunConsole) -> ExitCode:
    """Run a campaign after every change of its files, until its requirements are decided and confirmed.

    A file counts as changed when it stays the same between two looks. A campaign that cannot be used yet is reported
    and watched further. Raises CampaignFaults if the folder does not exist, EnvironmentProblem if the port is taken.
    """
    if not path.is_dir():
        raise CampaignFaults(
            [Fault(str(path), f"a folder that exists, in which a campaign.toml is or will be{suggested_folder(path)}")]
        )
    watch = _Watch(path, out)
    with _page(watch, options, console) as server:
        for _ in _changes(watch, options.interval_s):
            with console.during(f"round {watch.number + 1}"):
                state = watch.round()
            if server is not None:
                server.show(state, watch.run)
            if not options.as_json:
                for line in watch.lines:
                    console.detail(line)
            console.line(json.dumps(state.facts(), ensure_ascii=False) if options.as_json else state.line)
            if options.once or state.enough is Enough.ENOUGH:
                if server is not None:
                    server.wait_for_reader()
                return watch.code
    raise AssertionError("changes end only with an interruption")


@contextmanager
def _page(watch: _Watch, options: WatchOptions, console: RunConsole) -> Iterator[WatchServer | None]:
    """Serve the page of the rounds on this machine alone, if there is one."""
    with serving(options.port) if options.has_page and not options.once else nullcontext() as server:
        if server is not None and not options.as_json:
            console.line(f"page: {server.address} (this machine alone); end with Ctrl-C")
        yield server


def _changes(watch: _Watch, interval_s: float) -> Iterator[None]:
    """Yield at once, and whenever files have changed and then stay the same for one interval."""
    done: Snapshot | None = None
    before = _snapshot(watch)
    while True:
        time.sleep(interval_s)
        now = _snapshot(watch)
        if now == before and now != done:
            done = now
            yield
        before = now


def _snapshot(watch: _Watch) -> Snapshot:
    """Size and time of change of the files of the campaign, also of those that it reads in other folders."""
    snapshot = dict[str, tuple[int, int]]()
    for path in {*_visible_files(watch), *_read_files(watch.campaign)}:
        try:
            stat = path.stat()
        except OSError:  # it has just disappeared
            continue
        snapshot[str(path)] = stat.st_size, stat.st_mtime_ns
    return snapshot


def _visible_files(watch: _Watch) -> Iterator[Path]:
    """Files of the folder, without hidden ones, those that an editor holds open, and those of the run."""
    here = None if (run := watch.run) is None else run.resolve()
    for folder, names, files in os.walk(watch.place):
        names[:] = [name for name in names if not name.startswith(".") and (Path(folder) / name).resolve() != here]
        yield from (Path(folder) / name for name in files if not name.startswith((".", "~")))


def _read_files(campaign: CampaignFolder | None) -> tuple[Path, ...]:
    return () if campaign is None else raw_files(campaign.folder, campaign.document)


def _tables(run: Path) -> dict[str, pd.DataFrame]:
    read = ((name, table_of(run, name)) for name in _TABLES)
    return {name: table.to_pandas() for name, table in read if table is not None}
