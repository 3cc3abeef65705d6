"""A campaign with its run folder: its stages, their status, and their execution."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TypeVar

import truing
from truing.pipeline.campaign_folder import CampaignFolder, SettingsView, relative_name
from truing.pipeline.durations import DURATIONS_FILE as DURATIONS
from truing.pipeline.durations import Durations, forget_largest_memory, largest_memory
from truing.pipeline.freshness import Evidence, Freshness, StageStatus
from truing.pipeline.manifest import DigestCache, Entry, Manifest, StageInputs, digest_of, read_manifest
from truing.pipeline.problems import EnvironmentProblem
from truing.pipeline.run_folder import PRIVATE
from truing.pipeline.source_digest import SourceTree
from truing.pipeline.stage_order import (
    IN_PIECES,
    OF_SECOND_CAMPAIGNS,
    PAGE,
    RAW_READERS,
    is_optional,
    makers,
    order_of,
    stage_module,
    without_mark,
)
from truing.schemas.artifact import DamagedTable
from truing.schemas.artifacts import ARTIFACTS
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.verdict import ReasonCode
from truing.stages.declaration import Outcome, Stage

if TYPE_CHECKING:
    import pyarrow as pa

    from truing.schemas.artifact import Artifact, StoredTable
    from truing.schemas.campaign import Campaign
    from truing.stages.declaration import Progress

PROJECT = Path(truing.__file__).parent.parent
_VERDICT = "verdict"  # the artifact that decides the exit code
# Columns of its first row that the last lines of a run give.
_VERDICT_FIELDS = ("state", "reason_code", "decided_by", "explanation")
_Piece = TypeVar("_Piece")
Result = TypeVar("Result")


@dataclass
class CampaignRun:
    """A campaign's run folder, read when created; only ``execute`` and ``save`` write to it, and need its lock."""

    campaign: CampaignFolder
    folder: Path
    digest_cache: DigestCache
    manifest: Manifest
    scratch: Path | None = None  # for temporary files of raw-file readers; absent: the system's folder
    workers: int = 1  # processes for the independent pieces of one stage
    _raw_file_lists: dict[str, tuple[Path, ...]] = field(default_factory=dict)

    @cached_property
    def evidence(self) -> Evidence:
        """Basis for judging freshness."""
        source = SourceTree(PROJECT, self.digest_cache)
        return Evidence(self.campaign, self.folder, source, ARTIFACTS, self.digest_cache, self.manifest)

    @cached_property
    def order(self) -> tuple[Stage, ...]:
        """Declarations of this campaign's stages, in order."""
        names = _stage_names(self.campaign)
        order = tuple(self._declaration(name) for name in names)
        makers(order)
        return order

    def _declaration(self, name: str) -> Stage:
        """Declaration of a stage, without importing the stage if its source is known."""
        key = f"declaration of {name} {digest_of(self.evidence.source_of(name))}"
        known = self.digest_cache.fact(key)
        if known is None:
            known = asdict(stage_module(name).DECLARATION)
            self.digest_cache.note(key, known)
        lists = {field: tuple(known[field]) for field in ("reads", "leaves", "settings", "streams")}
        return Stage(name=known["name"], summary=known["summary"], **lists)

    @cached_property
    def durations(self) -> Durations:
        """Times that the stages took in this run folder."""
        raw = {path for name in RAW_READERS for path in self._raw_files(name)}
        sizes = (path.stat().st_size for path in raw if path.is_file())
        return Durations(self.folder / PRIVATE / DURATIONS, sum(sizes), self.workers)

    def made_from(self, stage: Stage) -> StageInputs:
        """Current inputs of a stage."""
        raw = self._raw_files(stage.name)
        if gone := [path for path in raw if self._digest_of_raw(path) is None]:
            expected = "a file that exists while it is read; this file has just disappeared"
            raise CampaignFaults(Fault(relative_name(path, self.campaign.folder), expected) for path in gone)
        return self.evidence.made_from(stage, raw)

    def _raw_files(self, stage: str) -> tuple[Path, ...]:
        """Raw files that a stage opens, as first found."""
        if stage in OF_SECOND_CAMPAIGNS and stage not in self._raw_file_lists:
            from truing.pipeline.second_campaign import files_of_second

            self._raw_file_lists[stage] = files_of_second(self.campaign)
        if stage not in (*RAW_READERS, *OF_SECOND_CAMPAIGNS):
            return ()
        if stage not in self._raw_file_lists:
            from truing.formats.source import raw_files

            self._raw_file_lists[stage] = raw_files(self.campaign.folder, self.campaign.document, RAW_READERS[stage])
        return self._raw_file_lists[stage]

    def status(self, stage: Stage, inputs: StageInputs) -> StageStatus:
        """Status of a stage; a fresh one is added to the manifest (in memory) if it was missing."""
        stage_status = self.evidence.status(stage, inputs)
        if stage_status.entry is not None:
            self.manifest.entries[stage.name] = stage_status.entry
        return stage_status

    def statuses(self) -> Iterator[tuple[Stage, StageStatus]]:
        """Status of every stage, those included that wait for a stale one."""
        maker = makers(self.order)
        stale_makers: dict[str, str] = {}
        for stage in self.order:
            status = self.status(stage, self.made_from(stage))
            waits = sorted({maker[name] for name in map(without_mark, stage.reads) if maker.get(name) in stale_makers})
            if waits and status.state is Freshness.FRESH:
                status = StageStatus(Freshness.STALE, (f"it depends on {', '.join(waits)}",))
            if status.state is not Freshness.FRESH:
                stale_makers[stage.name] = status.why
            yield stage, status

    @cached_property
    def settings(self) -> Campaign:
        """Validated settings; raises CampaignFaults."""
        return self.campaign.validated()

    def validate(self) -> None:
        """Validate campaign.toml unless the same content was found valid before; raises CampaignFaults."""
        validator = self.evidence.source.digests("truing.schemas.campaign")
        digest = digest_of([dict(self.campaign.document), validator])
        if digest != self.manifest.valid_campaign:
            _ = self.settings  # raises CampaignFaults if invalid
            self.manifest.valid_campaign = digest

    def execute(self, stage: Stage, inputs: StageInputs, progress: Progress) -> str:
        """Run a stage, write its artifacts and manifest entry; returns its closing line."""
        started = time.perf_counter()
        forget_largest_memory()
        try:
            outcome = self.outcome(stage, progress)
            _check_artifacts(stage, outcome)
            self._store(stage, inputs, outcome)
        except DamagedTable as error:  # of a table that is read in batches
            self._refuse_damaged(error.artifact, str(error))
        words = f"read {outcome.read}; left out {outcome.left_out}; {outcome.figure}"
        seconds = time.perf_counter() - started
        self.durations.note(stage.name, seconds, largest_memory())
        return f"{words}; {seconds:.2f} s"

    def outcome(self, stage: Stage, progress: Progress) -> Outcome:
        """Call a stage with exactly its declared inputs."""
        arguments: list[object] = [self._tables(stage), SettingsView(self.settings, stage.settings), progress]
        if stage.name in RAW_READERS:
            from truing.formats.source import NO_DIGESTS, CampaignFiles

            digests = self.made_from(stage).raw if stage.name == PAGE else NO_DIGESTS
            files = CampaignFiles(self.campaign.folder, self.settings, self.scratch, digests)
            if stage.name == PAGE:
                files.costs = self.durations.costs(one.name for one in self.order if one.name != PAGE)
            arguments.append(files)
        if stage.name in IN_PIECES:
            arguments.append(self._ordered_results)
        if stage.name in OF_SECOND_CAMPAIGNS:
            from truing.pipeline.second_campaign import second_campaign

            arguments.append(second_campaign(self.campaign, OF_SECOND_CAMPAIGNS[stage.name], self.scratch))
        outcome: Outcome = stage_module(stage.name).run(*arguments)
        return outcome

    def _ordered_results(
        self, work: Callable[[_Piece], Result], pieces: Sequence[_Piece], progress: Callable[[int], None]
    ) -> Iterator[Result]:
        """Results of all pieces, in order, computed in the processes of this campaign."""
        from truing.pipeline.executor import Workforce, results

        return results(work, pieces, Workforce(self.workers), _raise_lost_worker, progress)

    def _tables(self, stage: Stage) -> dict[str, pa.Table | StoredTable | str]:
        present = [name for name in map(without_mark, stage.reads) if self.evidence.input_digest(name) is not None]
        return {name: self._read(ARTIFACTS[name], in_batches=name in stage.streams) for name in present}

    def _read(self, artifact: Artifact, *, in_batches: bool) -> pa.Table | StoredTable | str:
        """Artifact of an earlier stage; raises EnvironmentProblem if it was damaged since."""
        from truing.pipeline.artifacts import Unreadable, opened_artifact, read_artifact

        try:
            return opened_artifact(self.folder, artifact) if in_batches else read_artifact(self.folder, artifact)
        except Unreadable as error:
            self._refuse_damaged(artifact, str(error))

    def _refuse_damaged(self, artifact: Artifact, why: str) -> NoReturn:
        path = self.folder / artifact.file
        self.digest_cache.discard_digest(path)  # so that its old digest is not used again
        self.digest_cache.save()
        raise EnvironmentProblem(f"{path} was changed after it was written ({why})") from None

    def _store(self, stage: Stage, inputs: StageInputs, outcome: Outcome) -> None:
        from truing import __version__
        from truing.pipeline.artifacts import Stamp, write_artifacts

        written, failed = tuple(outcome.artifacts), tuple(outcome.failed_checks)
        text = outcome.figure if type(outcome.figure) is str else ""  # ingest counts while its rows stream past
        stamp = Stamp(
            stage.name, inputs.digest, self.campaign.name, __version__, written, failed, text, outcome.why_not
        )
        files = {ARTIFACTS[name].file for name in written}  # two artifacts may share a file; a run writes one of them
        obsolete = [file for name in map(without_mark, stage.leaves) if (file := ARTIFACTS[name].file) not in files]
        digests = write_artifacts(
            self.folder, outcome.artifacts, stamp, obsolete, lambda: self._check_unchanged(stage.name, inputs)
        )
        self.manifest.entries[stage.name] = Entry(inputs.digest, digests, failed, inputs)
        self.save()

    def _check_unchanged(self, stage: str, then: StageInputs) -> None:
        """Raise EnvironmentProblem if a raw file changed while it was read."""
        for path in self._raw_files(stage) if then.raw else ():
            name = relative_name(path, self.campaign.folder)
            if self._digest_of_raw(path) != then.raw.get(name):
                raise EnvironmentProblem(
                    f"{name} changed or disappeared while it was read: another program writes to it"
                )

    def _digest_of_raw(self, path: Path) -> str | None:
        try:
            return self.digest_cache.digest(path)
        except FileNotFoundError:
            return None

    def save(self) -> None:
        """Write the manifest and the digest cache if they changed."""
        self.manifest.save(self.folder / PRIVATE / "ledger.json")
        self.digest_cache.save()

    def verdict(self, stages: tuple[Stage, ...]) -> dict[str, str]:
        """State, reason, deciding section and explanation of the campaign's verdict; empty without one among these.

        The digest cache holds them: reading a table takes longer than all else in a run with nothing to do.
        """
        digests = (entry.artifacts[_VERDICT] for entry in self._entries(stages) if _VERDICT in entry.artifacts)
        digest = next(digests, None)
        if digest is None:
            return {}
        known = self.digest_cache.fact(f"verdict {digest}")
        if known is None or set(_VERDICT_FIELDS) - set(known):  # an earlier version noted fewer fields
            from truing.pipeline.artifacts import table_of

            table = table_of(self.folder, _VERDICT)
            known = {} if table is None else {key: table.to_pylist()[0][key] for key in _VERDICT_FIELDS}
            self.digest_cache.note(f"verdict {digest}", known)
        return {key: known[key] or "" for key in _VERDICT_FIELDS} if known else {}

    def failed_checks(self, stages: tuple[Stage, ...]) -> tuple[str, ...]:
        """Failed checks in the last success of these stages."""
        entries = (entry for entry in self._entries(stages) if _VERDICT not in entry.artifacts)
        return tuple(check for entry in entries for check in entry.failed_checks)

    def is_refused(self, stages: tuple[Stage, ...]) -> bool:
        """True if the verdict refuses the data, or, without a verdict among these stages, if a check failed."""
        entries = self._entries(stages)
        verdicts = [entry for entry in entries if _VERDICT in entry.artifacts]
        return any(entry.failed_checks for entry in verdicts or entries)

    def _entries(self, stages: tuple[Stage, ...]) -> list[Entry]:
        entries = (self.manifest.entries.get(stage.name) for stage in stages)
        return [entry for entry in entries if entry is not None]


def _raise_lost_worker(piece: object) -> NoReturn:
    raise EnvironmentProblem(f"the process working on {piece} was lost several times (killed, or out of memory)")


def _check_artifacts(stage: Stage, outcome: Outcome) -> None:
    written, declared = set(outcome.artifacts), set(map(without_mark, stage.leaves))
    required = {name for name in stage.leaves if not is_optional(name)}
    if not required <= written <= declared:
        raise ValueError(f"{stage.name} wrote {sorted(written)}, but declares {sorted(stage.leaves)}")


def _stage_names(campaign: CampaignFolder) -> tuple[str, ...]:
    """Stages of a campaign, in order."""
    return order_of(campaign.kind, photographs=campaign.has_photographs, second=campaign.has_second)


def verdict_line(verdict: Mapping[str, str | None]) -> str:
    """The campaign's verdict as one line: state or kind of result, deciding section, explanation."""
    by = f" ({verdict['decided_by']})" if verdict["decided_by"] else ""
    reason = verdict["reason_code"]
    state = (ReasonCode(reason).result if reason else "") or verdict["state"]
    return f"verdict: {state}{by}. {verdict['explanation']}"


def detached_run(campaign: CampaignFolder) -> CampaignRun:
    """A campaign without a run folder, so that nothing can be written."""
    return CampaignRun(campaign, campaign.folder, DigestCache(None), Manifest())


def open_run(campaign: CampaignFolder, folder: Path, *, distrust: bool = False, workers: int = 1) -> CampaignRun:
    """A campaign with the content of its run folder; ``distrust`` reads every file again. Nothing is written."""
    private = folder / PRIVATE
    manifest = read_manifest(private / "ledger.json")
    manifest.entries = {  # another version may have had other stages with other artifacts
        name: entry
        for name, entry in manifest.entries.items()
        if name in _stage_names(campaign) and entry.artifacts.keys() <= ARTIFACTS.keys()
    }
    digests = DigestCache(private / "digests.json", distrust=distrust)
    return CampaignRun(campaign, folder, digests, manifest, private, workers)
