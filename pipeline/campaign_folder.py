"""Campaign folder: its campaign.toml, the settings that a stage may read, and its run folder."""

from __future__ import annotations

import os
import re
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.near_names import did_you_mean, nearest_name
from truing.schemas.settings_text import LARGEST, Document, TooDeep, TooLarge, parsed_toml, read_settings_text

if TYPE_CHECKING:
    from truing.schemas.campaign import Campaign


FILE = "campaign.toml"
RUNS = Path("runs")  # folder of all run folders, below the current folder
_UNSAFE = re.compile(r'[/\\:*?"<>|\x00-\x1f]')
# Device names that Windows reserves, with any extension.
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


@dataclass(frozen=True)
class CampaignFolder:
    """A campaign on disk: its folder, and campaign.toml parsed but not yet validated."""

    file: Path
    document: Document

    @property
    def folder(self) -> Path:
        """Folder to which paths in campaign.toml are relative."""
        return self.file.parent

    @property
    def name(self) -> str:
        """Name of the campaign, also of its run folder."""
        return str(self.document["campaign"]["name"])

    @property
    def kind(self) -> str:
        """photogrammetry or interferometer."""
        return str(self.document["campaign"]["kind"])

    @property
    def has_photographs(self) -> bool:
        """True if its object points come from photographs."""
        from truing.formats.source import has_photographs

        return self.kind == "photogrammetry" and has_photographs(self.folder, self.document)

    def validated(self) -> Campaign:
        """Settings of the campaign; raises CampaignFaults with every fault of campaign.toml."""
        from truing.schemas.campaign import read_campaign

        settings = read_campaign(dict(self.document), str(self.file))
        if settings.diagnosis.apply or settings.diagnosis.ignore:
            from truing.stages.diagnosis.search import cause_faults

            if faults := tuple(cause_faults(settings, str(self.file))):
                raise CampaignFaults(faults)
        if settings.comment or settings.campaign.logo:
            from truing.stages.common.campaign_facts import page_faults

            if faults := tuple(page_faults(settings, self.folder, str(self.file))):
                raise CampaignFaults(faults)
        return settings

    @property
    def has_second(self) -> bool:
        """True if its models predict a second campaign."""
        return self.section("diagnosis.judge_on") is not None

    def section(self, dotted: str) -> Any:
        """Raw value of a section by its dotted name; None if campaign.toml lacks it."""
        value: object = self.document
        for part in dotted.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        return value


def open_campaign(path: Path) -> CampaignFolder:
    """Parse the campaign.toml in a folder (or the file itself); raises CampaignFaults."""
    file = path if path.suffix == ".toml" and path.is_file() else path / FILE
    try:
        text = read_settings_text(file)
    except FileNotFoundError:
        raise CampaignFaults([Fault(str(file), _expected_instead(path))]) from None
    except TooLarge as error:
        expected = f"settings of at most {LARGEST >> 20} MB; put measured values into tables"
        raise CampaignFaults([Fault(str(file), expected, value=f"{error.size >> 20} MB")]) from None
    except UnicodeDecodeError as error:
        found = str(error.object[error.start : error.end])
        raise CampaignFaults([Fault(str(file), "text in UTF-8", value=found)]) from None
    try:
        return CampaignFolder(file, parsed_toml(text))
    except tomllib.TOMLDecodeError as error:
        raise CampaignFaults([_toml_fault(file, error)]) from None
    except TooDeep as error:
        raise CampaignFaults([Fault(str(file), f"valid TOML; {error}")]) from None
    except ValueError:  # Python converts no longer text to an integer
        longest = sys.get_int_max_str_digits()
        raise CampaignFaults([Fault(str(file), f"numbers of at most {longest} digits")]) from None


def _expected_instead(path: Path) -> str:
    if os.path.lexists(path / FILE):
        return "a regular file, not a folder, pipe, device or broken link"
    if path.is_dir():
        return f"a campaign.toml in this folder; `truing init {path}` writes one to complete"
    return f"a campaign folder that exists, with a campaign.toml in it{suggested_folder(path)}"


def suggested_folder(path: Path) -> str:
    """Suggestion for a folder that is missing, as the end of a message: the most similar name next to it."""
    if os.path.lexists(path):
        return ""
    try:
        beside = [one.name for one in path.parent.iterdir() if one.is_dir()]
    except OSError:
        return ""
    meant = nearest_name(path.name, beside)
    return "" if meant is None else f"; did you mean {path.with_name(meant)}?"


def _toml_fault(file: Path, error: tomllib.TOMLDecodeError) -> Fault:
    of_library = str(error)
    line = re.search(r"line (\d+)", of_library)
    what = of_library.split(" (at ")[0]
    return Fault(str(file), f"valid TOML; {what}", row=int(line[1]) if line else None)


def identity_faults(campaign: CampaignFolder) -> list[Fault]:
    """Faults of the two keys that a run needs first: name and kind."""
    from truing.pipeline.stage_order import ORDER

    section = campaign.document.get("campaign")
    section = section if isinstance(section, Mapping) else {}
    name, kind = section.get("name"), section.get("kind")
    faults = []
    if not isinstance(name, str) or not is_safe_name(name):
        expected = "a name that can be a folder's: no / \\ : * ? \" < > | and no dot or blank at its ends"
        faults.append(Fault(str(campaign.file), expected, column="campaign.name", value=_text_or_none(name)))
    if not isinstance(kind, str) or kind not in ORDER:
        expected = f"one of {', '.join(ORDER)}{did_you_mean(str(kind), ORDER)}"
        faults.append(Fault(str(campaign.file), expected, column="campaign.kind", value=_text_or_none(kind)))
    return faults


def _text_or_none(value: object) -> str | None:
    return None if value is None else str(value)


def is_safe_name(name: str) -> bool:
    """True if a campaign's name is a valid file name on Linux, macOS and Windows."""
    if not 0 < len(os.fsencode(name)) <= 120 or _UNSAFE.search(name) or _RESERVED.fullmatch(name):
        return False
    return name == name.strip(" .") and name.isprintable()


def run_folder_of(campaign: CampaignFolder, out: Path | None, several: bool) -> Path:
    """Folder of a campaign's run: ``--out``, else runs/<campaign name> below the current folder."""
    if out is None:
        return RUNS / campaign.name
    return out / campaign.name if several else out


def relative_name(path: Path, folder: Path) -> str:
    """Name of a raw file relative to its campaign, with forward slashes; absolute on another drive."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.as_posix()


class UndeclaredSetting(Exception):
    """A stage read a section of campaign.toml that its declaration does not name."""


class SettingsView:
    """The validated campaign, restricted to the declared sections; others raise UndeclaredSetting.

    ``read`` collects the declared sections that were read, so that a test can compare it with the declaration.
    """

    __slots__ = ("_declared", "_path", "_read", "_value")

    def __init__(self, value: object, declared: tuple[str, ...], path: str = "", read: set[str] | None = None) -> None:
        self._value = value
        self._declared = declared
        self._path = path
        self._read = set() if read is None else read

    @property
    def sections_read(self) -> frozenset[str]:
        """Declared sections that were read so far."""
        return frozenset(self._read)

    def __getattr__(self, name: str) -> Any:
        derived = getattr(type(self._value), name, None)
        if isinstance(derived, property) and derived.fget is not None:
            return derived.fget(self)  # properties derived from sections read them through this view
        path = f"{self._path}.{name}" if self._path else name
        if path in self._declared:
            self._read.add(path)
            return self._inner(name)
        if any(section.startswith(f"{path}.") for section in self._declared):
            inner = self._inner(name)
            return None if inner is None else SettingsView(inner, self._declared, path, self._read)
        raise UndeclaredSetting(f"{path} is read but not declared; declared are {', '.join(self._declared) or 'none'}")

    def _inner(self, name: str) -> object:
        """Value of a name in the section; None for an absent name chosen by the campaign."""
        return self._value.get(name) if isinstance(self._value, Mapping) else getattr(self._value, name)
