"""docs/real-data.md, rendered from the facts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "real-data.md"
_SHORT = {
    "irb120-faro": "irb",
    "so-lat-elevation": "lat",
    "so-lat-mirror": "mirror",
    "so-lat-sag": "sag",
    "so-lat-stability": "stability",
    "so-lat-sameday": "sameday",
    "so-lat-epochs": "epochs",
    "so-lat-vstars": "vstars",
    "mocap-static": "static",
    "mocap-full": "full",
    "lbcb-pier": "lbcb",
}


def render(facts: dict[str, dict[str, Any]]) -> str:
    environment = jinja2.Environment(trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string((HERE / "real-data.md.jinja").read_text(encoding="utf-8"))
    return template.render({_SHORT[name]: found for name, found in facts.items()}).rstrip() + "\n"
