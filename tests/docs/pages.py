"""The pages of the project, and the blocks of code on them, as a reader of Markdown sees them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

from tests.conftest import PROJECT

MARKDOWN = MarkdownIt("commonmark").enable("table")
# What stands within lines makes no block, and takes most of the time: every worker reads all pages to collect tests.
_BLOCKS = MarkdownIt("commonmark").disable("inline")
_REMARK = re.compile(r"\s*<!-- (given|not run): (.+?) -->\s*", re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A block of code: where it stands, its language, and what is remarked on it."""

    page: str
    line: int
    language: str
    text: str
    file: str | None
    given: tuple[str, ...]
    not_run: str | None

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"


@cache
def pages() -> dict[str, str]:
    """Text by name, relative to the project."""
    found = [PROJECT / "README.md", PROJECT / "CONTRIBUTING.md", *sorted((PROJECT / "docs").rglob("*.md"))]
    return {path.relative_to(PROJECT).as_posix(): path.read_text(encoding="utf-8") for path in found}


@cache
def blocks(page: str) -> tuple[Block, ...]:
    tokens = _BLOCKS.parse(pages()[page])
    return tuple(_block(page, tokens, k) for k, token in enumerate(tokens) if token.type in ("fence", "code_block"))


def _block(page: str, tokens: list[Token], k: int) -> Block:
    token = tokens[k]
    remark = _REMARK.fullmatch(tokens[k - 1].content) if k and tokens[k - 1].type == "html_block" else None
    kind, reported = remark.groups() if remark else ("", "")
    above = tokens[k - 2].content if k > 1 and tokens[k - 2].type == "inline" else ""
    file = re.fullmatch(r"`([\w.-]+)`", above)
    return Block(
        page,
        (token.map or [0])[0] + 1,
        "indented" if token.type == "code_block" else token.info,
        token.content,
        file[1] if file else None,
        tuple(name.strip() for name in reported.split(",")) if kind == "given" else (),
        reported if kind == "not run" else None,
    )


def all_blocks(*languages: str) -> list[Block]:
    return [block for page in pages() for block in blocks(page) if block.language in languages]


def folder_of(page: str) -> Path:
    return (PROJECT / page).parent
