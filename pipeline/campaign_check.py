"""Validation of a campaign: all faults of campaign.toml and of the raw files together."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truing.pipeline.campaign_folder import CampaignFolder, SettingsView, identity_faults, open_campaign
from truing.pipeline.campaign_run import CampaignRun, detached_run
from truing.pipeline.campaign_template import unconfirmed
from truing.pipeline.console import RunConsole
from truing.pipeline.problems import ExitCode
from truing.pipeline.second_campaign import second_folder
from truing.pipeline.stage_order import PAGE, RAW_READERS, is_optional, stage_module
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.settings_text import Document

if TYPE_CHECKING:
    import pyarrow as pa


_MOST_ROWS = 300_000  # rows of object points that `check` compares with readings; `run` compares all
_MOST_POSES = 1000  # of each target that are kept
_UNITS = ("temperature-unit", "time-unit")  # checks of single columns that a mapping can correct
_ROUNDS = 3  # removing a faulty key may reveal further faults


@dataclass(frozen=True)
class CampaignCheck:
    """Result of reading a campaign without faults: tables, stages that can run, and probable mistakes."""

    read: str
    prospects: tuple[str, ...] = ()
    attention: tuple[str, ...] = ()
    rows: int = 0  # of the object points
    is_evaluated: bool = True  # by any stage except qa
    ingested: Mapping[str, object] | None = None  # all tables of ingest; None if they are too large to be kept


def check_campaign(campaign: CampaignFolder) -> CampaignCheck:
    """Read and check everything without writing. Raises CampaignFaults with every fault."""
    from truing.formats.source import OF_IMAGES, CampaignFiles
    from truing.stages.evaluable_stages import CampaignContents, has_repeats, nothing_evaluated, prospects
    from truing.stages.ingestion.loading_tables import TABLES
    from truing.stages.probable_mistakes import attention

    faults = _settings_faults(campaign)
    if faults:
        taken_out = {(None, fault.column) for fault in faults if fault.column}  # every file needs these settings
        further = (each for each in _raw_faults_despite(campaign) if (each.row, each.column) not in taken_out)
        raise CampaignFaults([*faults, *further])
    run = detached_run(campaign)
    raw = _read_raw(run)
    source = CampaignFiles(campaign.folder, run.settings)
    given = frozenset(table for table in (*TABLES, *OF_IMAGES) if source.entries(table))
    campaign_contents = CampaignContents(raw.tables, raw.targets, campaign.has_photographs, given, raw.names)
    expected = tuple(prospects(run.settings, campaign_contents))
    rows = sum(sum(seen.values()) for seen in raw.targets.values())
    doubts = (*filter(None, (unconfirmed(campaign.file),)), *attention(run.settings, campaign_contents))
    statements = tuple(map(str, expected)), doubts
    is_evaluated = not nothing_evaluated(expected) or has_repeats(run.settings, campaign_contents)
    return CampaignCheck(raw.read, *statements, rows, is_evaluated, raw.ingested)


def check_before_photographs(run: CampaignRun) -> None:
    """Check everything except photographs before they are measured, which takes long; raises CampaignFaults."""
    _read_raw(run, measure=False)


def _settings_faults(campaign: CampaignFolder) -> list[Fault]:
    """All faults of campaign.toml."""
    known = {fault.column: fault for fault in identity_faults(campaign)}
    try:
        campaign.validated()
        if campaign.has_second and not known:
            second_folder(campaign).validated()
    except CampaignFaults as error:
        return [*known.values(), *(fault for fault in error.faults if fault.column not in known)]
    return list(known.values())


@dataclass
class _Raw:
    """Content of the raw files: summary, small tables, and targets of each body and pose."""

    messages: list[str] = field(default_factory=list)
    tables: dict[str, object] = field(default_factory=dict)
    targets: dict[str, Counter[object]] = field(default_factory=dict)
    names: dict[str, dict[str, set[object]]] = field(default_factory=dict)
    ingested: dict[str, object] | None = None
    _streamed: dict[str, list[pa.RecordBatch]] = field(default_factory=dict)

    @property
    def read(self) -> str:
        return "; ".join(self.messages)

    def counted(self, observations: Iterable[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        """Pass on batches of observations and count their targets."""
        for batch in observations:
            bodies, targets, poses = (batch.column(name).to_pylist() for name in ("body", "target", "pose"))
            for (body, pose), count in Counter(zip(bodies, poses, strict=True)).items():
                self.targets.setdefault(body, Counter())[pose] += count
            for body, target, pose in zip(bodies, targets, poses, strict=True):
                seen = self.names.setdefault(body, {}).setdefault(target, set())
                if len(seen) < _MOST_POSES:
                    seen.add(pose)
            yield batch

    def keep(self, artifacts: Mapping[str, object]) -> dict[str, object]:
        """Keep the small tables, and wrap streams so that they are kept, too, and observations counted."""
        import pyarrow as pa

        self.tables |= {name: content for name, content in artifacts.items() if isinstance(content, pa.Table)}
        streams = {name: content for name, content in artifacts.items() if isinstance(content, pa.RecordBatchReader)}
        watched = {name: self._collected(name, stream) for name, stream in streams.items()}
        if "observations" in watched:
            watched["observations"] = self.counted(watched["observations"])
        readers = {n: pa.RecordBatchReader.from_batches(streams[n].schema, each) for n, each in watched.items()}
        return {**artifacts, **readers}

    def _collected(self, name: str, batches: Iterable[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        streamed = self._streamed.setdefault(name, [])
        for batch in batches:
            if _rows(streamed) <= _MOST_ROWS:
                streamed.append(batch)
            yield batch

    def keep_ingested(self, artifacts: Mapping[str, object]) -> None:
        """Keep all tables of ingest, whose streams have been read, for the quality checks; none of large campaigns."""
        import pyarrow as pa

        streams = {name: content for name, content in artifacts.items() if isinstance(content, pa.RecordBatchReader)}
        if all(_rows(self._streamed[name]) <= _MOST_ROWS for name in streams):
            read = {n: pa.Table.from_batches(self._streamed[n], each.schema) for n, each in streams.items()}
            self.ingested = {**artifacts, **read}


def _rows(batches: Sequence[pa.RecordBatch]) -> int:
    return sum(map(len, batches))


def _read_raw(run: CampaignRun, *, measure: bool = True) -> _Raw:
    """Content of the raw files; ``measure``: photographs are opened too. Raises CampaignFaults with every fault."""
    from truing.formats.source import CampaignFiles
    from truing.pipeline.artifacts import drain

    raw = _Raw()
    faults: list[Fault] = []
    for stage in run.order:
        if stage.name not in RAW_READERS or stage.name == PAGE or not all(map(is_optional, stage.reads)):
            continue  # measuring photographs is too long for a check of the files, and the page shows none of them
        try:
            source = CampaignFiles(run.campaign.folder, run.settings)
            if stage.name == "images" and source.entries("images") and not measure:
                continue
            if stage.name == "images" and source.entries("images"):
                settings = SettingsView(run.settings, stage.settings)
                raw.messages.append(f"opened {stage_module(stage.name).photographs_summary(settings, source)}")
                continue
            outcome = run.outcome(stage, lambda done, total, what: None)
            drain(raw.keep(outcome.artifacts))
            if stage.name == "ingest":
                raw.keep_ingested(outcome.artifacts)
            raw.messages.append(f"read {outcome.read}; left out {outcome.left_out}")
        except CampaignFaults as error:
            faults += error.faults
    if "image_points" in raw.tables and "survey" in raw.tables:
        from truing.stages.image_tables.point_names import unknown_to_survey

        faults += unknown_to_survey(raw.tables["image_points"], raw.tables["survey"], raw.tables.get("scale_bars"))
    if faults:
        raise CampaignFaults(dict.fromkeys(faults))
    return raw


def _raw_faults_despite(campaign: CampaignFolder) -> tuple[Fault, ...]:
    """Faults of the raw files of a campaign whose campaign.toml has faults too, where they can be determined."""
    corrected = _without_faulty_keys(campaign)
    if corrected is None:
        return ()
    try:
        _read_raw(detached_run(corrected))
    except CampaignFaults as error:
        return error.faults
    except Exception:  # ingest need not accept a campaign with removed keys
        return ()
    return ()


def _without_faulty_keys(campaign: CampaignFolder) -> CampaignFolder | None:
    """The campaign without the faulty keys; None if it needs them."""
    document = copy.deepcopy(dict(campaign.document))
    if isinstance(document.get("campaign"), dict):
        document["campaign"]["name"] = "campaign"  # no data depend on the name
    corrected = replace(campaign, document=document)
    for _ in range(_ROUNDS):
        faults = _settings_faults(corrected)
        if not faults:
            return None if _is_read_otherwise(campaign, corrected) else corrected
        if not all(_remove(corrected.document, fault.column or "") for fault in faults):
            return None
    return None


def _is_read_otherwise(campaign: CampaignFolder, corrected: CampaignFolder) -> bool:
    """True if a campaign without its faulty keys has another kind of mechanism, which needs other files."""
    of_types = getattr(stage_module("ingest"), "OF_TYPES", {})
    given, corrected_section = (document.get("mechanism") for document in (campaign.document, corrected.document))
    return isinstance(given, dict) and given.get("type") in of_types and not corrected_section


def _remove(document: Document, dotted: str) -> bool:
    """Remove the value at a fault's dotted path (list indices count from 1); False if it is missing."""
    level: Any = document
    *parents, last = dotted.split(".")
    try:
        for part in parents:
            level = level[int(part) - 1] if isinstance(level, list) else level[part]
        del level[int(last) - 1 if isinstance(level, list) else last]
    except (KeyError, IndexError, ValueError, TypeError):
        return False
    return True


def report_check(path: Path, console: RunConsole) -> ExitCode:
    """`truing check` for one campaign: print the evaluable stages, or raise CampaignFaults."""
    campaign = open_campaign(path)
    campaign_check = check_campaign(campaign)
    unrelated = campaign.has_photographs or campaign_check.rows > _MOST_ROWS
    contradictions, doubtful = ((), ()) if unrelated else _contradictions(path, campaign_check.ingested)
    verdict = "no fault" if campaign_check.is_evaluated else "only the quality checks can be evaluated"
    if contradictions:
        verdict = "the files can be read, but the data contradict the campaign's description"
    attention = (*campaign_check.attention, *doubtful)
    facts = {
        "file": str(campaign.file),
        "result": verdict,
        "contradictions": contradictions,
        "prospects": campaign_check.prospects,
    }
    console.add_fact("campaigns", {**facts, "attention": attention})
    console.line(f"{campaign.file}: {verdict}; {campaign_check.read}")
    for line in contradictions or campaign_check.prospects:
        console.line(line)
    for sentence in attention:
        console.line(f"attention: {sentence}")
    return ExitCode.FAILED_CHECK if contradictions else ExitCode.DONE


def _contradictions(path: Path, ingested: Mapping[str, object] | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Messages of quality checks that contradict the campaign's description, failed or in doubt.

    ``ingested``: tables of ingest, which takes long for scans; read again if None.
    """
    from truing.pipeline.in_memory import as_read, stage_line
    from truing.stages.common.belonging import failed_relations

    line = stage_line(path)
    if ingested is None:
        line.call("ingest")
    else:
        line.tables |= {name: as_read(table) for name, table in ingested.items()}
    made = line.call("qa").tables
    tables = {name: table for name, table in made.items() if not isinstance(table, str)}
    checks, relations = (tables[name].to_pylist() if name in tables else [] for name in ("qa", "belonging"))
    failed = failed_relations(tables)
    doubted = {row["relation"] for row in relations if row["state"] == "attention"}
    belonging = tuple(row["message"] for row in checks if row["check"] in failed and row["verdict"] == "fail")
    doubtful = [row["message"] for row in checks if row["check"] in doubted and row["verdict"] == "warn"]
    far = {row["subject"]: row["message"] for row in checks if row["check"] == "noise" and _is_far(row["value"])}
    axes = {f"{subject} {axis}" for subject in far for axis in "xyz"}
    doubtful += [row["message"] for row in checks if row["check"] in _UNITS and row["verdict"] in ("warn", "fail")]
    return belonging, (*doubtful, *(message for subject, message in far.items() if subject not in axes))


def _is_far(ratio: float | None) -> bool:
    """True if a scatter differs so much from the declared noise that only another unit explains it."""
    from truing.stages.quality.unit_slips import IMPLAUSIBLE_RATIO

    return ratio is not None and not 1.0 / IMPLAUSIBLE_RATIO <= ratio <= IMPLAUSIBLE_RATIO
