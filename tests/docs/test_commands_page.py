"""docs/reference/commands.md lists every command and option."""

from __future__ import annotations

from docs.experiments.commands import PAGE, commands_page


def test_the_page_is_what_the_command_line_prints() -> None:
    assert PAGE.read_text(encoding="utf-8") == commands_page(), "run `python -m docs.experiments.commands`"
