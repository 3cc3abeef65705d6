"""Elements of the certificate's XML: texts that cannot break it, and numbers as D-SI writes them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from decimal import Decimal
from xml.etree.ElementTree import Element, SubElement, register_namespace

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
LANGUAGE = "en"
# What XML 1.0 does not allow as a character at all, escaped or not.
_NO_CHARACTER = re.compile(r"[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

register_namespace("dcc", DCC)
register_namespace("si", SI)


def dcc(parent: Element, name: str, text: str | None = None) -> Element:
    """Append an element of the certificate's namespace."""
    return _append(parent, f"{{{DCC}}}{name}", text)


def si(parent: Element, name: str, text: str | None = None) -> Element:
    """Append an element of D-SI."""
    return _append(parent, f"{{{SI}}}{name}", text)


def _append(parent: Element, tag: str, text: str | None) -> Element:
    child = SubElement(parent, tag)
    child.text = None if text is None else one_line(text)
    return child


def one_line(text: str) -> str:
    """A text without characters that XML cannot hold, its blanks single: never empty where it holds anything else."""
    return " ".join(_NO_CHARACTER.sub("\ufffd", str(text)).split())


def one_word(text: str) -> str:
    """A text for a list that is separated by blanks."""
    return one_line(text).replace(" ", "_") or "_"


def text(parent: Element, name: str, *sentences: str) -> Element:
    """Append a named element with content in the language of the certificate, which may stand there but once."""
    child = dcc(parent, name)
    dcc(child, "content", " ".join(sentences)).set("lang", LANGUAGE)
    return child


def optional(parent: Element, name: str, value: str | None) -> None:
    """Append an element where there is something to tell."""
    if value is not None:
        dcc(parent, name, value)


def rounded(value: float, uncertainty: float) -> tuple[str, str]:
    """An estimate and its expanded uncertainty of two significant digits, both to the same place (GUM 7.2.6)."""
    told = Decimal(f"{uncertainty:.1e}")
    return str(Decimal(repr(value)).quantize(told)), str(told)


def words(values: Iterable[str]) -> str:
    """A list as D-SI writes one."""
    return " ".join(values)
