"""``python -m docs.experiments.watch``: replay real campaigns pose by pose through `truing watch`.

Each campaign's files grow from a few poses to all. A requirement is added, and the table says after how many poses it
was decided, and whether all poses say the same. It is written between the marks of docs/how-to/watch.md.
"""

from __future__ import annotations

import gzip
import json
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from tests.real.campaigns import HERE, data_folder
from truing.pipeline.command_line import app

PAGE = Path(__file__).resolve().parents[1] / "how-to" / "watch.md"
_MARKS = "<!-- replays -->\n", "<!-- end -->"
_PATH = re.compile(r'^path = "\.\./.*shared/data/([^"]+)"', re.MULTILINE)


@dataclass(frozen=True)
class Replay:
    """A campaign of tests/real, the lines above the first pose in its files, and limits of the position, mm."""

    name: str
    header: int
    limits_mm: tuple[float, ...]
    poses: tuple[int, ...]
    key: str = "x_mm"
    excluded: tuple[int, ...] = ()  # poses with a wrong target


REPLAYS = (
    Replay(
        "irb120-faro-chain",
        0,
        (0.6, 1.0, 1.5, 2.5),
        (20, 30, 40, 60, 80, 120, 160, 240, 400),
        "x_mm",
        (22, 51, 136, 400),
    ),
    Replay("ipa-ur10-random", 1, (0.6,), (20, 30, 40, 60, 80, 120, 160, 240, 400)),
)


def grown(replay: Replay, poses: int, limit_mm: float, folder: Path) -> Path:
    """The campaign with its first poses only, and with a requirement."""
    folder.mkdir(parents=True, exist_ok=True)
    text = (HERE / replay.name / "campaign.toml").read_text(encoding="utf-8")
    for pattern in dict.fromkeys(_PATH.findall(text)):
        for file in sorted(data_folder().glob(pattern)):
            whole = gzip.decompress(file.read_bytes()) if file.suffix == ".gz" else file.read_bytes()
            lines = whole.splitlines(keepends=True)[: replay.header + poses]
            (folder / file.name.removesuffix(".gz")).write_bytes(b"".join(lines))
        text = re.sub(rf'"[^"]*shared/data/{re.escape(pattern)}"', f'"{Path(pattern).name.removesuffix(".gz")}"', text)
    out = [
        f'[[exclude]]\npose = {pose}\nby = "replay"\nreason = "joints-against-links names it"\n'
        for pose in replay.excluded
        if pose <= poses
    ]
    asked = f"[requirement]\n{replay.key} = {limit_mm}\n"
    (folder / "campaign.toml").write_text("\n".join([text, asked, *out]), encoding="utf-8")
    return folder


def _watched(folder: Path, run: Path) -> dict[str, Any]:
    words = ["watch", str(folder), "--once", "--json", "--interval", "0.1", "--out", str(run)]
    done = CliRunner().invoke(app, words)
    told: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return told


def _decision(told: dict[str, Any]) -> str:
    """The reason code of the verdict on requirements, or why there is none."""
    own = [row["reason_code"] for row in told["verdicts"] if row["section"] == "requirements"]
    return str(own[0]) if own and told["enough"] != "not judged" else str(told["enough"])


def rows(replays: Sequence[Replay], folder: Path) -> Iterator[tuple[str, ...]]:
    """Rows of the table: campaign, requirement, first decision of one look, where the watch ends, the last look.

    All looks of a replay are one watch: one campaign folder that grows, and one run.
    """
    for replay in replays:
        for limit in replay.limits_mm:
            decisions, ended = dict[int, str](), dict[int, str]()
            own = folder / f"{replay.name}-{limit}"
            for poses in replay.poses:
                told = _watched(grown(replay, poses, limit, own), Path(f"{own}-run"))
                decisions[poses] = _decision(told)
                if told["enough"] == "enough":
                    ended[poses] = decisions[poses]
                sys.stdout.write(f"{replay.name} {limit} mm, {poses} poses: {decisions[poses]}, {told['enough']}\n")
                sys.stdout.flush()
            first = next(((n, found) for n, found in decisions.items() if found in ("met", "not-met")), None)
            end = next(iter(ended.items()), None)
            last = replay.poses[-1], decisions[replay.poses[-1]]
            yield replay.name, f"{limit:g} mm", *map(_words, (first, end, last))


def _words(decision: tuple[int, str] | None) -> str:
    """``met at 60`` poses; a dash where nothing was decided."""
    return "–" if decision is None else f"{decision[1].replace('-', ' ')} at {decision[0]}"


def main() -> None:
    """Replay all, and write the table."""
    with tempfile.TemporaryDirectory() as folder:
        found = list(rows(REPLAYS, Path(folder)))
    heads = "campaign", "limit of x", "first decision", "watch ends", "last look"
    head = f"| {' | '.join(heads)} |\n{'| --- ' * len(heads)}|\n"
    table = head + "".join(f"| {' | '.join(row)} |\n" for row in found)
    before, rest = PAGE.read_text(encoding="utf-8").split(_MARKS[0])
    after = rest.split(_MARKS[1])[1]
    PAGE.write_text(f"{before}{_MARKS[0]}{table}{_MARKS[1]}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
