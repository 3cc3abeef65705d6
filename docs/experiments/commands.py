"""``python -m docs.experiments.commands``: write docs/reference/commands.md from the command line itself."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import typer

from truing.pipeline.command_line import app

PAGE = Path(__file__).resolve().parents[1] / "reference" / "commands.md"
_HEAD = """# Which commands and options are there?

This page lists the commands of `truing` with their options (made by `python -m docs.experiments.commands`).
Exit codes and remedies: [running](../running.md#what-the-exit-code-says).

| command | does |
| --- | --- |
"""


def commands_page() -> str:
    """The whole page as Markdown."""
    commands: dict[str, Any] = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    rows = "".join(
        f"| [`truing {name}`](#truing-{name}) | {_paragraphs(command)[0]} |\n" for name, command in commands.items()
    )
    sections = ["\n".join(_section(name, command)) for name, command in commands.items()]
    return f"{_HEAD}{rows}\n" + "\n".join(sections).rstrip().replace("<", "\\<") + "\n"


def _paragraphs(command: Any) -> list[str]:
    return [" ".join(part.split()) for part in command.help.split("\n\n")]


def _section(name: str, command: Any) -> Iterator[str]:
    reported = [part for part in _paragraphs(command) if not part.startswith("Example: ")]
    shown = [part.removeprefix("Example: ") for part in _paragraphs(command) if part.startswith("Example: ")]
    arguments = [parameter for parameter in command.params if parameter.param_type_name == "argument"]
    options = [parameter for parameter in command.params if parameter.param_type_name == "option"]
    usage = " ".join(_written(argument) for argument in arguments)
    yield f"## `truing {name}`\n"
    yield from (f"{part}\n" for part in reported)
    yield f"```text\ntruing {name} {'[OPTIONS] ' if options else ''}{usage}\n```\n"
    yield "| it takes | default | meaning |\n| --- | --- | --- |"
    yield from (
        f"| `{_metavar(argument)}` | {'required' if argument.required else ''} | {argument.help} |"
        for argument in arguments
    )
    yield from (_row(option) for option in options)
    yield "\n```sh\n" + "\n".join(shown) + "\n```\n"


def _metavar(argument: Any) -> str:
    return str(argument.metavar or argument.name.upper())


def _written(argument: Any) -> str:
    word = _metavar(argument) + ("..." if argument.nargs == -1 and "..." not in _metavar(argument) else "")
    return word if argument.required else f"[{word}]"


def _row(option: Any) -> str:
    choices = list(type(option.default)) if isinstance(option.default, Enum) else []
    word = "\\|".join(choices) or ("" if option.is_flag else option.metavar or "N")
    plain = option.default is None or option.default == "" or option.is_flag
    default = "" if plain else f"`{option.default}`"
    within = "" if option.min is None else f" From {option.min:g}" + (f" to {option.max:g}." if option.max else ".")
    return f"| `{' '.join([*option.opts, *([word] if word else [])])}` | {default} | {option.help}{within} |"


if __name__ == "__main__":
    PAGE.write_text(commands_page(), encoding="utf-8")
