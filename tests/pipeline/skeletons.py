"""The campaign.toml of `truing init` with every commented line activated, as its head explains."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from truing.schemas.campaign import read_campaign

_PROPOSED = re.compile(r"# ?(?P<line>\s*(\[\[?[\w.]+\]\]?|[\w]+ = \S.*|\{.*\},?|\])(\s*#.*)?)\s*")


def activated(text: str) -> str:
    """The text of a skeleton with each proposed line active, and prose left as remarks."""
    matches = ((line, _PROPOSED.fullmatch(line)) for line in text.splitlines())
    return "\n".join(line if match is None else match["line"] for line, match in matches) + "\n"


def assert_valid_if_activated(text: str) -> None:
    """Read a skeleton as it is, and with its proposed lines active; of alternatives, one by one."""
    read_campaign(tomllib.loads(text))
    document = tomllib.loads(activated(text))
    mechanism: dict[str, Any] = document.get("mechanism", {})
    if "legs" in mechanism:  # the skeleton shows the entry of one leg
        mechanism["legs"] *= 6
    alternatives = [name for name in ("urdf", "dh") if name in mechanism]
    for name in alternatives or [""]:
        others = {alternative for alternative in alternatives if alternative != name}
        kept = {key: value for key, value in mechanism.items() if key not in others}
        read_campaign({**document, "mechanism": kept} if mechanism else document)
