"""Faults in declarations of campaign.toml: names, later surveys, repeats, decisions."""

from __future__ import annotations

from pathlib import Path

from tests.broken.spoiling import Broken, Spoil, appended
from truing.pipeline.problems import ExitCode

_TOML = "campaign.toml"


def _renamed(target: str, called: str) -> Spoil:
    return appended(_TOML, f'\n[[renamed]]\nbody = "base"\ntarget = "{target}"\ncalled = "{called}"\n')


def _base_again(folder: Path) -> None:
    """The base once more, as a later survey whose name is end; its first target has moved by 1 mm."""
    rows = [line.split(",") for line in (folder / "targets.csv").read_text(encoding="utf-8").splitlines()[1:]]
    base = [["end", *row[:5]] for row in rows if row[0] == "base"]
    base[0][3] = str(float(base[0][3]) + 1.0)
    text = "".join(",".join(row) + "\n" for row in [["survey", "body", "target", "x_mm", "y_mm", "z_mm"], *base])
    (folder / "resurveys.csv").write_text(text, encoding="utf-8")


def _repeats(folder: Path) -> None:
    lines = (folder / "configurations.csv").read_text(encoding="utf-8").splitlines()
    lines = [f"{lines[0]},repeat_of", *(f"{line}," for line in lines[1:-1]), f"{lines[-1]},1000"]
    (folder / "configurations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


_NO_REASON = '\n[[exclude]]\ntarget = "B01"\nby = "A. Kern"\n'

CASES = (
    Broken("renamed-onto-another", "telescope", _renamed("B01", "B02"), ("once; B02 is B01 there", "renamed.1")),
    Broken("renamed-on-a-bench", "bench", _renamed("B01", "B02"), ("a bench has no targets",)),
    Broken("resurvey-moved-unnoticed", "telescope", _base_again, ("resurvey",), ExitCode.FAILED_CHECK),
    Broken("repeat-of-nothing", "telescope", _repeats, ("repeat_of", "1000", "a pose of this table")),
    Broken("exclusion-without-reason", "telescope", appended(_TOML, _NO_REASON), ("exclude.1.reason", "present")),
    Broken(
        "exclusion-on-no-day",
        "telescope",
        appended(_TOML, _NO_REASON + 'reason = "loose"\non = "yesterday"\n'),
        ("exclude.1.on", "yesterday"),
    ),
)
