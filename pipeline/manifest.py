"""Manifest of a run folder: inputs and artifacts of each stage, and digests of unchanged files."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from truing.pipeline.atomic_file import write_atomically
from truing.schemas.settings_text import Document, regular_size

# Two changes within one clock tick of the file system give the same time; the tick of FAT is two seconds.
TICK_NS = 2_000_000_000
# Facts that depend only on the bytes of a file, shared by all campaigns of this process.
_PROCESS_FACTS: dict[str, object] = {}


def canonical(value: object) -> str:
    """JSON that is equal for equal values, independent of key order."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)


def digest_of(value: object) -> str:
    """SHA-256 of a value's canonical JSON."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()


@dataclass(frozen=True)
class StageInputs:
    """Inputs that determine a stage's artifacts; digests are SHA-256, None for an absent input."""

    campaign: str
    source: Mapping[str, str]
    settings: Mapping[str, object]
    inputs: Mapping[str, str | None]
    raw: Mapping[str, str]

    @property
    def digest(self) -> str:
        """Digest that the stage's artifacts carry."""
        return digest_of(asdict(self))


@dataclass(frozen=True)
class Entry:
    """Last success of a stage. ``artifacts`` maps names to the SHA-256 of the file's bytes."""

    digest: str
    artifacts: Mapping[str, str]
    failed_checks: tuple[str, ...] = ()
    made_from: StageInputs | None = None

    @cached_property
    def indented(self) -> str:
        """JSON as a value among the manifest's entries; kept, since every stage of a run saves all entries again."""
        return json.dumps(asdict(self), indent=1, default=str).replace("\n", "\n  ")


@dataclass(frozen=True)
class Owner:
    """Campaign of a run folder: name, absolute path and digest of its campaign.toml; and the path of the run folder at
    that time, to recognise a copy."""

    name: str
    file: str
    settings: str
    folder: str


@dataclass
class Manifest:
    """Entries of a run folder, digest of the last valid campaign.toml, and owner."""

    entries: dict[str, Entry] = field(default_factory=dict)
    valid_campaign: str = ""
    owner: Owner | None = None

    def save(self, store: Path) -> None:
        """Write the manifest atomically, unless it is unchanged."""
        rows = ",\n".join(f"  {json.dumps(name)}: {entry.indented}" for name, entry in self.entries.items())
        entries = f"{{\n{rows}\n }}" if rows else "{}"
        owner = None if self.owner is None else asdict(self.owner)
        other_keys = json.dumps({"valid_campaign": self.valid_campaign, "owner": owner}, indent=1)
        content = f'{{\n "entries": {entries},{other_keys[1:]}'.encode()
        if not store.is_file() or store.read_bytes() != content:
            write_atomically(store, content)


def read_manifest(store: Path) -> Manifest:
    """Manifest of a run folder; empty if missing or unreadable."""
    try:
        regular_size(store)
        content = json.loads(store.read_bytes())
        entries = {name: _entry(row) for name, row in content["entries"].items()}
        return Manifest(entries, str(content["valid_campaign"]), _owner(content.get("owner")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return Manifest()


def _entry(row: Document) -> Entry:
    """An entry written by this or another version; raises if it is none."""
    recorded = row["made_from"]
    made_from = None
    if recorded is not None:
        parts = {name: dict(recorded[name]) for name in ("source", "settings", "inputs", "raw")}
        made_from = StageInputs(str(recorded["campaign"]), **parts)
    return Entry(str(row["digest"]), dict(row["artifacts"]), tuple(map(str, row["failed_checks"])), made_from)


def _owner(recorded: Mapping[str, object] | None) -> Owner | None:
    """The owner as written; None if absent."""
    return None if recorded is None else Owner(*(str(recorded[key]) for key in ("name", "file", "settings", "folder")))


class DigestCache:
    """SHA-256 of files, and facts derived from their bytes, in one JSON file of the run folder."""

    def __init__(self, store: Path | None, *, distrust: bool = False) -> None:
        self._store = store
        self._content = _load(store)
        self._files: dict[str, list[int | str]] = {} if distrust else self._content["files"]
        self._facts: dict[str, object] = self._content["facts"]
        self._changed = distrust
        self.trusts_times = not distrust  # of files unchanged since the last digest

    def digest(self, path: Path) -> str:
        """SHA-256 of a file's bytes; raises FileNotFoundError."""
        key = os.path.abspath(path)
        status = os.stat(path)
        if not stat.S_ISREG(status.st_mode):
            raise FileNotFoundError(errno.ENOENT, "no regular file is there", str(path))
        identity = [status.st_size, status.st_mtime_ns, status.st_ino]
        known = self._files.get(key)
        if known is not None and known[:3] == identity:
            return str(known[3])
        with open(path, "rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        if time.time_ns() - status.st_mtime_ns > TICK_NS:
            self._files[key] = [*identity, digest]
            self._changed = True
        return digest

    def discard_digest(self, path: Path) -> None:
        """Read a file again at the next request of its digest."""
        self._changed = self._files.pop(os.path.abspath(path), None) is not None or self._changed

    def fact(self, digest: str) -> Any | None:
        """Fact noted about the file with these bytes, here or for another run folder, or None."""
        if digest not in self._facts and digest in _PROCESS_FACTS:
            self.note(digest, _PROCESS_FACTS[digest])
        return self._facts.get(digest)

    def note(self, digest: str, fact: object) -> None:
        """Note a fact (JSON) that depends only on a file's bytes."""
        self._facts[digest] = _PROCESS_FACTS[digest] = fact
        self._changed = True

    def save(self) -> None:
        """Write new digests and facts to the run folder."""
        if self._changed and self._store is not None:
            content = {"files": self._files, "facts": self._facts}
            lines = json.dumps({**content, "sum": digest_of(content)}, separators=(",\n", ": "))
            write_atomically(self._store, lines.encode())
            self._changed = False


def _load(store: Path | None) -> dict[str, dict[str, Any]]:
    if store is not None:
        with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
            regular_size(store)
            content = json.loads(store.read_bytes())
            if content.pop("sum") == digest_of(content):  # as it was written, so of the form that it was written in
                return {"files": dict(content["files"]), "facts": dict(content["facts"])}
    return {"files": {}, "facts": {}}
