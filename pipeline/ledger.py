"""What a run folder remembers of each stage: what it was made from, what it left, and its closing line."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from truing.pipeline.whole_file import write_whole
from truing.schemas.settings_text import regular_size


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
class Ledger:
    """The entries of a run folder, the digest of the last campaign.toml that was found valid, and whose run it is."""

    entries: dict[str, Entry] = field(default_factory=dict)
    valid_campaign: str = ""
    owner: Owner | None = None

    def save(self, store: Path) -> None:
        """Write the ledger whole, unless it stands there already."""
        content = json.dumps(asdict(self), indent=1, default=str).encode()
        if not store.is_file() or store.read_bytes() != content:
            write_whole(store, content)


def read_ledger(store: Path) -> Ledger:
    """The ledger of a run folder; an empty one where there is none, or none that can be read."""
    try:
        regular_size(store)
        content = json.loads(store.read_bytes())
        entries = {name: _entry(row) for name, row in content["entries"].items()}
        return Ledger(entries, str(content["valid_campaign"]), _owner(content.get("owner")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return Ledger()


def _entry(row: dict[str, Any]) -> Entry:
    """An entry as it was written, by this version or another; raises where it is none."""
    told = row["made_from"]
    made_from = None
    if told is not None:
        parts = {name: dict(told[name]) for name in ("source", "settings", "inputs", "raw")}
        made_from = MadeFrom(str(told["campaign"]), **parts)
    return Entry(str(row["digest"]), dict(row["artifacts"]), tuple(map(str, row["failed_checks"])), made_from)


def _owner(told: Any) -> Owner | None:
    """The owner as it was written; None where nobody has noted one."""
    return None if told is None else Owner(*(str(told[key]) for key in ("name", "file", "settings", "folder")))
