"""Equations as inline SVG, so that pages need no script, font or network to show them."""

from __future__ import annotations

import html
import re
from functools import cache

import ziamath
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

_SIZE = 16.0  # of what is drawn, in units that CSS then counts as em
# A matrix that carries an index or a mark has to stand in braces for the library.
_RAISED = re.compile(r"(\\begin\{(\w+)\}(?:(?!\\begin).)*?\\end\{\2\})(?=[_^'])", re.DOTALL)
# With an index that it may place itself, the library takes a sum within brackets for endlessly high.
_SUMMED = re.compile(r"\\(sum|prod)(?=_)")
# Between a function's name and what it is of stands a small space.
_FUNCTION = r"\\(?:operatorname\{\w+\}|(?:arg|cos|det|exp|ln|log|max|min|sin|tan)(?![A-Za-z]))"
_SPACED = re.compile(rf"({_FUNCTION}|[A-Za-z0-9)}}](?=\s+{_FUNCTION}))\s*(?=[A-Za-z0-9\s]|\\(?!left|[,;!]))")
_HIGHEST = 15.0  # in heights of a letter
_log = logging.getLogger(__name__)

ziamath.config.svg2 = False  # every drawing whole: identifiers shared by many would be defined many times
ziamath.config.math.color = "currentColor"


@cache
def drawn(latex: str, inline: bool) -> str:
    """An equation as an SVG element as high as the text around it, with its source as its name for a screen reader."""
    equation = ziamath.Math.fromlatex(_prepared(latex), size=_SIZE, inline=inline)
    unknown = re.search(r"\\[A-Za-z]+", equation.mathmlstr())
    if unknown:
        raise ValueError(f"cannot draw {unknown.group()}")
    if equation.getsize()[1] > _HIGHEST * _SIZE:
        raise ValueError("drawn higher than any equation is")
    svg = equation.svg()
    width, height = (float(text) / _SIZE for text in re.findall(r'(?:width|height)="([\d.]+)"', svg)[:2])
    style = f"width:{width:.3f}em;height:{height:.3f}em;vertical-align:{equation.getyofst() / _SIZE:.3f}em"
    name = html.escape(" ".join(latex.split()), quote=True)
    size = re.search(r'width="[^"]*" height="[^"]*"', svg)
    assert size is not None
    return svg.replace(size.group(), f'style="{style}" role="img" aria-label="{name}"', 1)


def _prepared(latex: str) -> str:
    """An equation as the library draws it as LaTeX would."""
    latex = _SPACED.sub(r"\1\\, ", _RAISED.sub(r"{\1}", latex))
    return _SUMMED.sub(r"\\\1\\limits", latex) if r"\left" in latex else latex


def _write(page: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Put an equation into a page; what cannot be drawn is a fault of the page."""
    block = isinstance(node, nodes.math_block)
    latex = node.astext()
    try:
        picture = drawn(latex, not block)
    except Exception as fault:  # whatever the library stumbles over
        _log.warning("equation %r: %r", latex, fault, location=node)
        picture = html.escape(latex)
    page.body.append(f'<div class="equation">{picture}</div>' if block else f'<span class="equation">{picture}</span>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer of equations."""
    app.add_html_math_renderer("drawn", inline_renderers=(_write, None), block_renderers=(_write, None))
    app.config.html_math_renderer = "drawn"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
