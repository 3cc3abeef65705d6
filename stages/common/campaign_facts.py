"""Facts of campaign.toml for the first screen of the page: names, machine, instrument, dates, logo."""

from __future__ import annotations

import base64
import json
import math
import os
import platform
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, date, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from truing.report.page import CampaignFacts, RawFileFacts
from truing.report.sections import section_names
from truing.schemas.faults import CampaignFaults, Fault
from truing.schemas.near_names import did_you_mean

if TYPE_CHECKING:
    from truing.formats.source import CampaignFiles
    from truing.schemas.campaign import Campaign
    from truing.schemas.certificate import Contact, Item

_TYPES = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}
SECTIONS_SHOWN = ("noise", "measurement", "bodies", "requirement", "diagnosis", "interferometer", "signals")
_MOST_BYTES = 1_000_000
_OPENCV = ("opencv-contrib-python-headless", "opencv-python-headless", "opencv-python")
_OF_LINES = (".csv", ".txt", ".tsv", ".dat", ".asc", ".xyz", ".gsi", ".trc", ".rtl", ".urdf", ".xml", ".toml", ".json")
_MACHINES = {
    "6-pus": "hexapod with linear actuators at the base (6-PUS)",
    "ups": "platform on {} legs of variable length (UPS)",
    "6-upur": "force sensor on {} elastic legs (6-UPUR)",
}
_PROCESSORS = Path("/proc/cpuinfo")
_EXPECTED = "a picture of at most 1 MB in PNG, JPEG or SVG"


def campaign_facts(settings: Campaign, files: CampaignFiles | None = None) -> CampaignFacts:
    """Return the facts for the page; raises CampaignFaults for a logo that is no picture."""
    from truing import __version__

    campaign, certificate = settings.campaign, settings.certificate
    days = tuple(str(day) for day in (certificate.begin, certificate.end) if day is not None)
    return CampaignFacts(
        title=campaign.title or "",
        laboratory=campaign.laboratory or _name(certificate.laboratory),
        customer=campaign.customer or _name(certificate.customer),
        operator=campaign.operator or "",
        logo=_data_uri(campaign.logo, files.folder) if campaign.logo and files is not None else "",
        item=_item(certificate.item),
        machine=_machine(settings),
        instrument=", ".join(filter(None, map(_item, certificate.equipment))),
        measured=days,
        made=str(_today()),
        version=__version__,
        comments=tuple((comment.section, comment.text) for comment in settings.comment),
        declared=tuple(_declared(settings)),
        software=tuple(_software(__version__, of_photographs=bool(settings.photographs.model_fields_set))),
        persons=tuple((person.name or "", person.role or "") for person in certificate.persons),
        files=() if files is None else tuple(_raw_files(files)),
        costs=() if files is None or _epoch() is not None else files.costs,
    )


def _declared(settings: Campaign) -> Iterator[tuple[str, str]]:
    """Yield the keys of campaign.toml that results rest on, as far as they are set, with their values."""
    for name in SECTIONS_SHOWN:
        section = getattr(settings, name, None)
        declared = {} if section is None else section.model_dump(mode="json", exclude_unset=True, exclude_none=True)
        yield from ((f"{name}.{key}", _written(value)) for key, value in declared.items())


def _written(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _software(version: str, *, of_photographs: bool) -> Iterator[tuple[str, str]]:
    """Yield the programs and libraries whose numbers are on the page; OpenCV finds the targets in photographs."""
    yield "truing", version
    yield "Python", platform.python_version()
    for name in ("numpy", "scipy", "pandas", "pyarrow", *_OPENCV * of_photographs):
        with suppress(metadata.PackageNotFoundError):
            yield name, metadata.version(name)
    yield "system", f"{platform.system()} {platform.machine()}"
    if processor := processor_model():
        yield "processor", processor


def processor_model(listed: Path = _PROCESSORS) -> str:
    """Return the model of the processor, from Linux's list or from the system; empty where neither is known."""
    with suppress(OSError):
        for line in listed.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, model = line.partition(":")
            if name.strip() == "model name" and model.strip():
                return " ".join(model.split())
    processor = platform.processor()
    return processor if processor != platform.machine() else ""


def _raw_files(files: CampaignFiles) -> Iterator[RawFileFacts]:
    """Yield facts of the files that the campaign was read from."""
    for name, digest in sorted(files.digests.items()):
        path = files.folder / name
        facts = path.stat()
        changed = datetime.fromtimestamp(min(facts.st_mtime, _epoch() or math.inf), UTC)
        lines = _lines(path) if path.suffix.lower() in _OF_LINES else None
        yield RawFileFacts(name, facts.st_size, lines, digest, f"{changed:%Y-%m-%d %H:%M}")


def _lines(path: Path) -> int:
    """Return the number of lines of a text file; the last one may lack its end."""
    count, last = 0, b"\n"
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            count, last = count + block.count(b"\n"), block[-1:]
    return count + (last != b"\n")


def _name(contact: Contact) -> str:
    return contact.name or ""


def _item(item: Item) -> str:
    number = f"no. {item.identification}" if item.identification else ""
    return " ".join(filter(None, (item.name, item.manufacturer, item.model, number)))


def _machine(settings: Campaign) -> str:
    """Return the type of a mechanism with legs in words; empty for others."""
    legs = getattr(settings.mechanism, "legs", None)
    if not legs:
        return ""
    return _MACHINES.get(settings.mechanism.type, f"{settings.mechanism.type}, {{}} legs").format(len(legs))


def _today() -> date:
    """Return the day of the page: today, or that of SOURCE_DATE_EPOCH."""
    epoch = _epoch()
    return (datetime.now(UTC) if epoch is None else datetime.fromtimestamp(epoch, UTC)).date()


def _epoch() -> int | None:
    """Return SOURCE_DATE_EPOCH, by which builds are repeated: the page then has no clock and no times of stages."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    return int(epoch) if epoch.isdecimal() else None


def page_faults(settings: Campaign, folder: Path, file: str) -> Iterator[Fault]:
    """Yield the faults of keys for the page: comments on sections that no page has, and a logo that is no picture."""
    known = section_names()
    for k, comment in enumerate(settings.comment, 1):
        if comment.section not in known:
            hint = did_you_mean(comment.section, known) or f"; there are {', '.join(known)}"
            column = f"comment.{k}.section"
            yield Fault(file, f"the id of a section of the page{hint}", column=column, value=comment.section)
    if settings.campaign.logo:
        try:
            _data_uri(settings.campaign.logo, folder)
        except CampaignFaults as error:
            yield from (replace(fault, file=file) for fault in error.faults)


def _data_uri(logo: str, folder: Path) -> str:
    """Return a picture as a data URI, which a page holds without a second file; raises CampaignFaults."""
    try:
        content = (folder / logo).read_bytes()
    except OSError as error:
        raise CampaignFaults([_fault(f"{_EXPECTED}: {error.strerror}", logo)]) from None
    kind = next((kind for begin, kind in _TYPES.items() if content.startswith(begin)), "")
    if not kind and b"<svg" in content[:2000]:
        kind = "image/svg+xml"
    if not kind or len(content) > _MOST_BYTES:
        raise CampaignFaults([_fault(_EXPECTED, f"{logo} ({len(content):,} bytes)")])
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _fault(expected: str, value: str) -> Fault:
    return Fault("campaign.toml", expected, column="campaign.logo", value=value)
