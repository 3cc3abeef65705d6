"""What a run folder remembers: what each stage was made from and left, and digests of files that did not change."""

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
from pathlib import Path
from typing import Any

from truing.pipeline.whole_file import write_atomically
from truing.schemas.settings_text import regular_size

# A file changed again within one tick of its file system's clock keeps its time; FAT ticks every two seconds.
TICK_NS = 2_000_000_000
# Facts that hold of the same bytes wherever they are asked for: a process that runs many campaigns works out each once.
_OF_THIS_PROCESS: dict[str, Any] = {}


def canonical(value: Any) -> str:
    """JSON that is equal where the values are equal, whatever their order of writing."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)


def digest_of(value: Any) -> str:
    """SHA-256 of a value's canonical JSON."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()


@dataclass(frozen=True)
class MadeFrom:
    """Everything that a stage's artifacts follow from; digests are SHA-256, an absent input is None."""

    campaign: str
    source: Mapping[str, str]
    settings: Mapping[str, Any]
    inputs: Mapping[str, str | None]
    raw: Mapping[str, str]

    @property
    def digest(self) -> str:
        """The digest that the stage's artifacts carry."""
        return digest_of(asdict(self))


@dataclass(frozen=True)
class Entry:
    """One stage's last success. ``artifacts`` maps names to the SHA-256 of the file's bytes."""

    digest: str
    artifacts: Mapping[str, str]
    failed_checks: tuple[str, ...] = ()
    made_from: MadeFrom | None = None


@dataclass(frozen=True)
class Owner:
    """The campaign whose run a folder holds: name, absolute place of its campaign.toml, digest of what that says; and
    where the run folder lay then, by which a copy of it is known."""

    name: str
    file: str
    settings: str
    folder: str


@dataclass
class Manifest:
    """The entries of a run folder, the digest of the last campaign.toml that was found valid, and whose run it is."""

    entries: dict[str, Entry] = field(default_factory=dict)
    valid_campaign: str = ""
    owner: Owner | None = None

    def save(self, store: Path) -> None:
        """Write the manifest whole, unless it stands there already."""
        content = json.dumps(asdict(self), indent=1, default=str).encode()
        if not store.is_file() or store.read_bytes() != content:
            write_atomically(store, content)


def read_manifest(store: Path) -> Manifest:
    """The manifest of a run folder; an empty one where there is none, or none that can be read."""
    try:
        regular_size(store)
        content = json.loads(store.read_bytes())
        entries = {name: _entry(row) for name, row in content["entries"].items()}
        return Manifest(entries, str(content["valid_campaign"]), _owner(content.get("owner")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return Manifest()


def _entry(row: dict[str, Any]) -> Entry:
    """An entry as it was written, by this version or another; raises where it is none."""
    reported = row["made_from"]
    made_from = None
    if reported is not None:
        parts = {name: dict(reported[name]) for name in ("source", "settings", "inputs", "raw")}
        made_from = MadeFrom(str(reported["campaign"]), **parts)
    return Entry(str(row["digest"]), dict(row["artifacts"]), tuple(map(str, row["failed_checks"])), made_from)


def _owner(reported: Any) -> Owner | None:
    """The owner as it was written; None where nobody has noted one."""
    return None if reported is None else Owner(*(str(reported[key]) for key in ("name", "file", "settings", "folder")))


class DigestCache:
    """SHA-256 of files, and facts derived from their bytes, kept in one JSON file of the run folder."""

    def __init__(self, store: Path | None, *, distrust: bool = False) -> None:
        self._store = store
        self._content = _load(store)
        self._files: dict[str, list[Any]] = {} if distrust else self._content["files"]
        self._facts: dict[str, Any] = self._content["facts"]
        self._changed = distrust
        self.trusts_times = not distrust  # of files that did not change since they were looked at

    def digest(self, path: Path) -> str:
        """The SHA-256 of a file's bytes; raises FileNotFoundError."""
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

    def forget(self, path: Path) -> None:
        """Read a file anew when its digest is asked for again."""
        self._changed = self._files.pop(os.path.abspath(path), None) is not None or self._changed

    def fact(self, digest: str) -> Any | None:
        """What was noted about the file with these bytes, here or for another run folder, or None."""
        if digest not in self._facts and digest in _OF_THIS_PROCESS:
            self.note(digest, _OF_THIS_PROCESS[digest])
        return self._facts.get(digest)

    def note(self, digest: str, fact: Any) -> None:
        """Note something (JSON) that follows from a file's bytes alone."""
        self._facts[digest] = _OF_THIS_PROCESS[digest] = fact
        self._changed = True

    def save(self) -> None:
        """Write what is new to the run folder."""
        if self._changed and self._store is not None:
            content = {"files": self._files, "facts": self._facts}
            write_atomically(self._store, json.dumps({**content, "sum": digest_of(content)}, indent=0).encode())
            self._changed = False


def _load(store: Path | None) -> dict[str, Any]:
    if store is not None:
        with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
            regular_size(store)
            content = json.loads(store.read_bytes())
            if content.pop("sum") == digest_of(content):  # as it was written, so of the form that it was written in
                return {"files": dict(content["files"]), "facts": dict(content["facts"])}
    return {"files": {}, "facts": {}}
