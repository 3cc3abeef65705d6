"""Conversion of docstrings for Sphinx: plain sentences with names in backticks, where a star or a bar is literal."""

from __future__ import annotations

import re
from enum import Enum
from importlib import import_module
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import truing

_HOME = {f"{room}.{name}": f"truing.{name}" for name, room in truing._MODULES.items()}


def plain(line: str) -> str:
    """A line whose marks outside of backticks mean nothing."""
    parts = re.split(r"(``.*?``|`[^`]*`)", line)
    return "".join(part if n % 2 else re.sub(r"([*|\\]|_\b(?=\W|$))", r"\\\1", part) for n, part in enumerate(parts))


def _process(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    lines[:] = [plain(line) for line in lines]


def _as_written(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Types by the names that the code gives them."""
    return tuple(text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in (signature, returned))


def _at_its_public_name(app: Sphinx, env: Any, node: Any, text: nodes.Element) -> nodes.Element | None:
    """A type that a signature names by its room is described by its public name."""
    public = _HOME.get(node.get("reftarget", ""))
    if public is None or node.get("refdomain") != "py":
        return None
    domain = env.get_domain("py")
    return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", public, node, text)


class Names(SphinxDirective):
    """A line per name: of `truing`, or with its module; functions, classes with their members."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Ask autodoc for each, in its own language."""
        reported = "\n\n".join(_automatic(name if "." in name else f"truing.{name}") for name in self.content if name)
        return self.parse_text_to_nodes(f"```{{eval-rst}}\n{reported}\n```\n")


def _automatic(name: str) -> str:
    module, _, last = name.rpartition(".")
    thing = getattr(import_module(module), last)
    if not isinstance(thing, type):
        return f".. autofunction:: {name}"
    return f".. autoclass:: {name}\n   :members:" + ("\n   :undoc-members:" if issubclass(thing, Enum) else "")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to the events of autodoc."""
    app.add_directive("names", Names)
    app.connect("autodoc-process-docstring", _process)
    app.connect("autodoc-process-signature", _as_written)
    app.connect("missing-reference", _at_its_public_name)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
