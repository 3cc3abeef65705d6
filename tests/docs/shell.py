"""Check of a command line on a page: program, command, options and files exist."""

from __future__ import annotations

import ast
import importlib.util
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from tests.conftest import PROJECT
from truing.pipeline.command_line import app
from truing.pipeline.stage_order import ORDER

# What a reader's shell or a cluster brings along, and what is not ours to check.
FOREIGN = {
    *("cat", "cd", "cp", "git", "ls", "mkdir", "rm"),
    *("dask", "docker", "dvc", "pip", "pipx", "sbatch", "snakemake", "srun", "uv"),
}
_MAKE_TARGETS = set(re.findall(r"^([a-z]+):", (PROJECT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
_TRUING: Any = typer.main.get_command(app)
# Some versions of typer bring a click of their own.
_Refused = next(kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException")
_ENVIRONMENT = re.compile(r"(?:\S*/)?\.venv/(?:bin|Scripts)/")


def commands(text: str) -> Iterator[list[str]]:
    """The words of each command: a line holds one, or several between ``&&``, ``;`` and ``|``."""
    for line in text.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars=";&|<>")
        lexer.whitespace_split = True
        words: list[str] = []
        for word in [*lexer, ";"]:
            if set(word) <= set(";&|"):
                if words:
                    yield words
                words = []
            else:
                words.append(word)


def fault(words: list[str], written: set[str]) -> str | None:
    """Return the fault of a command in a folder with the files written by the page, or None."""
    while words and re.fullmatch(r"[A-Z_]+=\S*", words[0]):
        words = words[1:]
    if not words:
        return None
    program, arguments = _ENVIRONMENT.sub("", words[0]), words[1:]
    lost = [word for word in arguments if not _is_there(word)]
    if lost:
        return f"no {lost[0]} in the project"
    if program == "truing":
        return _fault_of_truing(arguments)
    if program == "make":
        known = {*_MAKE_TARGETS, *(name for names in ORDER.values() for name in names)}
        return next((f"no target {a}" for a in arguments if "=" not in a and a not in known), None)
    if re.fullmatch(r"python3?(\.\d+)?", program):
        return _fault_of_python(arguments, written)
    return None if program in FOREIGN else f"{program} is no program that pages may ask for"


def _is_there(word: str) -> bool:
    ours = re.match(r"(sample_data|docs|requirements|tests|benchmarks)/", word)
    return not ours or any(PROJECT.glob(word.rstrip("/")))


def _fault_of_truing(arguments: list[str]) -> str | None:
    context = _TRUING.context_class(_TRUING, info_name="truing")
    if arguments == ["--help"]:
        return None
    try:
        name, command, rest = _TRUING.resolve_command(context, arguments)
        if command is not None and rest != ["--help"]:
            command.make_context(name, list(rest), parent=context)
    except _Refused as error:
        return str(error.format_message())
    return None


def _fault_of_python(arguments: list[str], written: set[str]) -> str | None:
    if not arguments or arguments[0] != "-m":
        return None if arguments and arguments[0] in written else "python runs a module, or a file of the page"
    module, options = arguments[1], [a.partition("=")[0] for a in arguments[2:] if a.startswith("--")]
    found = importlib.util.find_spec(module)
    if found is None:
        return f"no module {module}"
    place = Path(found.origin or "")
    if not place.is_relative_to(PROJECT) or ".venv" in place.parts:
        return None
    source = place if place.name != "__init__.py" else place.with_name("__main__.py")
    known = {node.value for node in ast.walk(ast.parse(source.read_text("utf-8"))) if isinstance(node, ast.Constant)}
    return next((f"{module} has no {option}" for option in options if option not in known), None)
