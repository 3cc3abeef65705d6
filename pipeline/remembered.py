"""Digests of files, remembered by size, time and inode, so that what did not change is not read again."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from truing.pipeline.ledger import digest_of
from truing.pipeline.whole_file import write_whole
from truing.schemas.settings_text import regular_size

# A file changed again within one tick of its file system's clock keeps its time; FAT ticks every two seconds.
TICK_NS = 2_000_000_000
# Facts that hold of the same bytes wherever they are asked for: a process that runs many campaigns works out each once.
_OF_THIS_PROCESS: dict[str, Any] = {}


class RememberedDigests:
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
            write_whole(self._store, json.dumps({**content, "sum": digest_of(content)}, indent=0).encode())
            self._changed = False


def _load(store: Path | None) -> dict[str, Any]:
    if store is not None:
        with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
            regular_size(store)
            content = json.loads(store.read_bytes())
            if content.pop("sum") == digest_of(content):  # as it was written, so of the form that it was written in
                return {"files": dict(content["files"]), "facts": dict(content["facts"])}
    return {"files": {}, "facts": {}}
