"""What a stage sees of campaign.toml: the sections that it declares, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class UndeclaredSetting(Exception):
    """A stage read a section of campaign.toml that its declaration does not name."""


class SettingsView:
    """Reads like the validated campaign; raises UndeclaredSetting outside the declared sections.

    ``read`` collects the declared sections that were read, so that a test can hold the declaration against the truth.
    """

    __slots__ = ("_declared", "_path", "_read", "_value")

    def __init__(self, value: Any, declared: tuple[str, ...], path: str = "", read: set[str] | None = None) -> None:
        self._value = value
        self._declared = declared
        self._path = path
        self._read = set() if read is None else read

    @property
    def sections_read(self) -> frozenset[str]:
        """The declared sections that were read so far."""
        return frozenset(self._read)

    def __getattr__(self, name: str) -> Any:
        derived = getattr(type(self._value), name, None)
        if isinstance(derived, property) and derived.fget is not None:
            return derived.fget(self)  # what is derived from sections reads them through this view
        path = f"{self._path}.{name}" if self._path else name
        if path in self._declared:
            self._read.add(path)
            return self._inner(name)
        if any(section.startswith(f"{path}.") for section in self._declared):
            inner = self._inner(name)
            return None if inner is None else SettingsView(inner, self._declared, path, self._read)
        raise UndeclaredSetting(f"{path} is read but not declared; declared are {', '.join(self._declared) or 'none'}")

    def _inner(self, name: str) -> Any:
        """What the section holds under a name; of one whose names are the campaign's own, None where it has no such."""
        return self._value.get(name) if isinstance(self._value, Mapping) else getattr(self._value, name)
