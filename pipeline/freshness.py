"""Freshness of stages: whether a stage is up to date, and the reason if not, by content and never by time stamps."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from truing.pipeline.campaign_folder import CampaignFolder, relative_name
from truing.pipeline.manifest import DigestCache, Entry, Manifest, StageInputs, canonical
from truing.pipeline.source_digest import SourceTree
from truing.pipeline.stage_order import OF_SECOND_CAMPAIGNS, without_mark

if TYPE_CHECKING:
    from truing.schemas.artifact import Artifact
    from truing.stages.declaration import Stage

# Modules through which settings and tables reach every stage, so that both affect its results.
_COMMON_SOURCE = ("truing.schemas.campaign", "truing.schemas.artifacts")
_SHOWN_REASONS = 3
# Metadata from which an artifact replaces a missing manifest entry of its stage.
_SPOKEN = {"digest", "left", "failed_checks"}


class Freshness(StrEnum):
    """State of a stage."""

    FRESH = "fresh"
    STALE = "stale"
    NEVER_RUN = "never run"


@dataclass(frozen=True)
class StageStatus:
    """State of a stage, the reasons if it is not fresh, and its manifest entry if it is."""

    state: Freshness
    reasons: tuple[str, ...] = ()
    entry: Entry | None = None

    @property
    def why(self) -> str:
        """Reasons in one line."""
        more = len(self.reasons) - _SHOWN_REASONS
        return "; ".join(self.reasons[:_SHOWN_REASONS]) + (f"; and {more} more" if more > 0 else "")


@dataclass(frozen=True)
class Evidence:
    """Basis for judging freshness: the campaign, the run folder and the project's source."""

    campaign: CampaignFolder
    run_folder: Path
    source: SourceTree
    artifacts: Mapping[str, Artifact]
    digest_cache: DigestCache
    manifest: Manifest

    def source_of(self, stage: str) -> dict[str, str]:
        """Digests of the source files of a stage."""
        called = (f"truing.stages.{name}" for name in (stage, *OF_SECOND_CAMPAIGNS.get(stage, ())))
        return self.source.digests(*called, *_COMMON_SOURCE)

    def made_from(self, stage: Stage, raw: tuple[Path, ...]) -> StageInputs:
        """Inputs of the stage if it ran now; ``raw``: files that it reads besides artifacts."""
        folder = self.campaign.folder
        return StageInputs(
            campaign=self.campaign.name,
            source=self.source_of(stage.name),
            settings={section: self.campaign.section(section) for section in sorted(stage.settings)},
            inputs={name: self.input_digest(name) for name in sorted(map(without_mark, stage.reads))},
            raw={relative_name(path, folder): self.digest_cache.digest(path) for path in raw},
        )

    def input_digest(self, artifact: str) -> str | None:
        """Digest of an artifact of an earlier stage, or None."""
        return next((e.artifacts[artifact] for e in self.manifest.entries.values() if artifact in e.artifacts), None)

    def status(self, stage: Stage, now: StageInputs) -> StageStatus:
        """Return the status of a stage: fresh if its artifacts are unchanged, and made from the inputs ``now``."""
        entry = self.manifest.entries.get(stage.name) or self._embedded(stage)
        if entry is None:
            return StageStatus(Freshness.NEVER_RUN, ("it has no artifacts",))
        reasons = [*self._artifact_reasons(entry), *_changes(entry, now)]
        if reasons:
            return StageStatus(Freshness.STALE, tuple(reasons))
        return StageStatus(Freshness.FRESH, entry=Entry(entry.digest, entry.artifacts, entry.failed_checks, now))

    def _artifact_reasons(self, entry: Entry) -> Iterator[str]:
        for name, digest in entry.artifacts.items():
            file = self.artifacts[name].file
            try:
                if self.digest_cache.digest(self.run_folder / file) != digest:
                    yield f"{file} was changed after it was written"
            except FileNotFoundError:
                yield f"{file} is missing"  # or a folder, or a pipe

    def _embedded(self, stage: Stage) -> Entry | None:
        """Entry from the metadata of a stage's artifacts, if the manifest is missing."""
        from truing.pipeline.artifacts import read_provenance

        for name in map(without_mark, stage.leaves):
            carried = read_provenance(self.run_folder, self.artifacts[name])
            if carried is not None and carried.get("stage") == stage.name and carried.keys() >= _SPOKEN:
                try:
                    return self._entry_from(carried)
                except (ValueError, KeyError, TypeError, RecursionError):  # written by another version
                    return None
        return None

    def _entry_from(self, carried: Mapping[str, str]) -> Entry:
        from truing.pipeline.artifacts import read_provenance

        digests = {}
        for name in json.loads(carried["left"]):
            sibling = read_provenance(self.run_folder, self.artifacts[name])
            is_unchanged = sibling is not None and sibling.get("digest") == carried["digest"]
            digests[name] = (
                self.digest_cache.digest(self.run_folder / self.artifacts[name].file) if is_unchanged else ""
            )
        return Entry(carried["digest"], digests, tuple(json.loads(carried["failed_checks"])))


def _changes(entry: Entry, now: StageInputs) -> Iterator[str]:
    if entry.digest == now.digest:
        return
    then = entry.made_from
    if then is None:
        yield "its inputs differ (the manifest of the run folder is missing, so the change is unknown)"
        return
    if then.campaign != now.campaign:
        yield f"the campaign is {now.campaign!r}, not {then.campaign!r}"
    yield from _setting_changes(dict(then.settings), dict(now.settings))
    yield from _file_changes("raw file ", then.raw, now.raw)
    yield from _file_changes("source of ", then.source, now.source)
    yield from _file_changes("", _digests_of_present(then.inputs), _digests_of_present(now.inputs), ".parquet")


def _digests_of_present(inputs: Mapping[str, str | None]) -> dict[str, str]:
    return {name: digest for name, digest in inputs.items() if digest is not None}


def _file_changes(label: str, then: Mapping[str, str], now: Mapping[str, str], ending: str = "") -> Iterator[str]:
    for name in sorted({*then, *now}):
        if name not in now:
            yield f"{label}{name}{ending} is no longer an input"
        elif name not in then:
            yield f"{label}{name}{ending} is a new input"
        elif then[name] != now[name]:
            yield f"{label}{name}{ending} changed"


def _setting_changes(then: object, now: object, path: str = "") -> Iterator[str]:
    """Differences of two parsed TOML values, leaf by leaf."""
    if canonical(then) == canonical(now):
        return
    if isinstance(then, dict) and isinstance(now, dict):
        for key in sorted({*then, *now}):
            yield from _setting_changes(then.get(key), now.get(key), f"{path}.{key}" if path else key)
    elif isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        for number, (left, right) in enumerate(zip(then, now, strict=True), start=1):
            yield from _setting_changes(left, right, f"{path}[{number}]")
    elif then is None:
        yield f"{path} is new: {_brief(now)}"
    elif now is None:
        yield f"{path} was removed: it was {_brief(then)}"
    else:
        yield f"{path} changed from {_brief(then)} to {_brief(now)}"


def _brief(value: object) -> str:
    text = canonical(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
