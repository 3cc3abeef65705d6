"""``python -m docs.experiments.watch``: replay real campaigns through `truing watch`, as if just measured.

Each campaign's files grow from a few poses (or runs of loads) to all. A requirement is added, and the table says after
how many it was decided, and whether all say the same. It is written between the marks of docs/how-to/watch.md.
"""

from __future__ import annotations

import gzip
import io
import json
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from typer.testing import CliRunner

from tests.real.campaigns import HERE, data_folder
from truing.pipeline.command_line import app

PAGE = Path(__file__).resolve().parents[1] / "how-to" / "watch.md"
_MARKS = "<!-- replays -->\n", "<!-- end -->"
_PATH = re.compile(r'^path = "\.\./.*shared/data/([^"]+)"', re.MULTILINE)


@dataclass(frozen=True)
class Replay:
    """A campaign of tests/real, the lines above the first pose in its files, limits in the unit of ``key``, and looks.

    run: column of a Parquet file that names the runs by which it grows; empty for files that grow by lines, one a pose.
    """

    name: str
    header: int
    limits: tuple[float, ...]
    looks: tuple[int, ...]
    key: str = "x_mm"
    excluded: tuple[int, ...] = ()  # poses with a wrong target
    run: str = ""

    @property
    def unit(self) -> str:
        """Unit of the limits."""
        return {"mm": "mm", "n": "N"}[self.key.partition("_")[2]]

    def cut(self, file: Path, amount: int) -> bytes:
        """The first poses, or runs, of a file."""
        whole = gzip.decompress(file.read_bytes()) if file.suffix == ".gz" else file.read_bytes()
        if not self.run:
            return b"".join(whole.splitlines(keepends=True)[: self.header + amount])
        table = pq.read_table(io.BytesIO(whole))
        names = [str(name) for name in table.column(self.run).to_pylist()]
        first = set(list(dict.fromkeys(names))[:amount])
        cut = io.BytesIO()
        pq.write_table(table.filter([name in first for name in names]), cut)
        return cut.getvalue()


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
    Replay("optical-ft-ur3e", 0, (1.5, 4.0, 6.0), (12, 24, *range(36, 61, 2)), "fz_n", run="source_file"),
    Replay("so-lat-elevation", 1, (0.1,), (5, 10, 19)),
)


def grown(replay: Replay, amount: int, limit: float, folder: Path) -> Path:
    """The campaign with its first poses or runs only, and with a requirement."""
    folder.mkdir(parents=True, exist_ok=True)
    text = (HERE / replay.name / "campaign.toml").read_text(encoding="utf-8")
    for pattern in dict.fromkeys(_PATH.findall(text)):
        for file in sorted(data_folder().glob(pattern)):
            (folder / file.name.removesuffix(".gz")).write_bytes(replay.cut(file, amount))
        text = re.sub(rf'"[^"]*shared/data/{re.escape(pattern)}"', f'"{Path(pattern).name.removesuffix(".gz")}"', text)
    for file in (HERE / replay.name).glob("*.csv"):
        (folder / file.name).write_bytes(file.read_bytes())
    out = [
        f'[[exclude]]\npose = {pose}\nby = "replay"\nreason = "joints-against-links names it"\n'
        for pose in replay.excluded
        if pose <= amount
    ]
    asked = f"[requirement]\n{replay.key} = {limit}\n"
    (folder / "campaign.toml").write_text("\n".join([text, asked, *out]), encoding="utf-8")
    return folder


def _watched(folder: Path, run: Path) -> dict[str, Any]:
    words = ["watch", str(folder), "--once", "--json", "--interval", "0.1", "--out", str(run)]
    done = CliRunner().invoke(app, words)
    reported: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return reported


def _decision(stated: dict[str, Any]) -> str:
    """The reason code of the verdict on requirements, or why there is none."""
    own = [row["reason_code"] for row in stated["verdicts"] if row["section"] == "requirements"]
    return str(own[0]) if own and stated["enough"] != "not judged" else str(stated["enough"])


def rows(replays: Sequence[Replay], folder: Path) -> Iterator[tuple[str, ...]]:
    """Rows of the table: campaign, requirement, first decision of one look, where the watch ends, the last look.

    All looks of a replay are one watch: one campaign folder that grows, and one run.
    """
    for replay in replays:
        for limit in replay.limits:
            decisions, ended = dict[int, str](), dict[int, str]()
            own = folder / f"{replay.name}-{limit}"
            for amount in replay.looks:
                reported = _watched(grown(replay, amount, limit, own), Path(f"{own}-run"))
                decisions[amount] = _decision(reported)
                if reported["enough"] == "enough":
                    ended[amount] = decisions[amount]
                sys.stdout.write(f"{replay.name} {limit}, {amount}: {decisions[amount]}, {reported['enough']}\n")
                sys.stdout.flush()
            first = next(((n, found) for n, found in decisions.items() if found in ("met", "not-met")), None)
            end = next(iter(ended.items()), None)
            last = replay.looks[-1], decisions[replay.looks[-1]]
            asked = f"{replay.key.partition('_')[0]}: {limit:g} {replay.unit}"
            yield replay.name, asked, "runs" if replay.run else "poses", *map(_words, (first, end, last))


def _words(decision: tuple[int, str] | None) -> str:
    """``met at 60``; a dash where nothing was decided."""
    return "–" if decision is None else f"{decision[1].replace('-', ' ')} at {decision[0]}"


def main() -> None:
    """Replay all, or those named on the command line, and write the table; rows of others stay."""
    before, rest = PAGE.read_text(encoding="utf-8").split(_MARKS[0])
    old, after = rest.split(_MARKS[1])
    chosen = [one for one in REPLAYS if not sys.argv[1:] or one.name in sys.argv[1:]]
    kept = [tuple(cell.strip() for cell in line.strip("| ").split("|")) for line in old.splitlines()[2:]]
    with tempfile.TemporaryDirectory() as folder:
        drawn = list(rows(chosen, Path(folder)))
    named = {one.name for one in chosen}
    found = [r for one in REPLAYS for r in (drawn if one.name in named else kept) if r[0] == one.name]
    heads = "campaign", "limit", "of", "first decision", "watch ends", "last look"
    head = f"| {' | '.join(heads)} |\n{'| --- ' * len(heads)}|\n"
    table = head + "".join(f"| {' | '.join(row)} |\n" for row in found)
    PAGE.write_text(f"{before}{_MARKS[0]}{table}{_MARKS[1]}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
