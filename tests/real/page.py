"""docs/real-data.md, rendered from the facts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2

from tests.real.force_facts import LINEAR, PRODUCTS, SQUARES
from truing.report.numbers import with_uncertainty

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
    "fareke-file1": "file1",
    "fareke-file2": "file2",
    "fareke-file3": "file3",
    "sps01-stewart-force": "sps",
    "optical-ft-ur3e": "optical",
    "sios-nmm-quadrature": "sios",
    "ess-slit-iso230": "slit",
}
_MODELS = {"linear": LINEAR, "squares": SQUARES, "products": PRODUCTS}


def render(facts: dict[str, dict[str, Any]], raw: dict[str, Any]) -> str:
    """The page from the facts of the campaigns, and from those of files that are none."""
    return rendered("real-data.md.jinja", facts, raw)


def rendered(template: str, facts: dict[str, dict[str, Any]], raw: dict[str, Any]) -> str:
    """One of the templates here, which may hold others."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE), trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["sure_to"] = with_uncertainty
    short = {_SHORT[name]: fact for name, fact in facts.items()}
    return environment.get_template(template).render(short | _MODELS | {"raw": raw}).rstrip() + "\n"
