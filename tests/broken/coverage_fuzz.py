"""Guide random bytes by what they make a reader do: ``python -m tests.broken.coverage_fuzz csv -max_total_time=120``.

Needs atheris, which the project does not ask for. Further words are libFuzzer's, seeds the good campaigns of `fuzz`. It
stops and keeps the bytes at an exception that is none of a reader's own, after five seconds, or beyond three gigabytes.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["truing", "schemas", "pipeline", "tests"]):
    from tests.broken.more_subjects import more_files
    from tests.formats.reading import read
    from truing.formats.sniff import sniff_file
    from truing.pipeline.campaign_folder import open_campaign
    from truing.schemas.faults import CampaignFaults
    from truing.simulation.bench.extended_model import read_sensor
    from truing.simulation.mechanisms.extended_model import read_model

_BOUNDS = ("-timeout=5", "-rss_limit_mb=3000", "-max_len=8192")
_MAPPED = {"constants": {"body": "b"}, "unit": "mm"}


def _table(file: str, table: str = "points", **entry: object) -> Callable[[Path, bytes], None]:
    def call(folder: Path, content: bytes) -> None:
        (folder / file).write_bytes(content)
        read(folder, table, {"path": file, **entry})

    return call


def _looked_at(folder: Path, content: bytes) -> None:
    (folder / "a.csv").write_bytes(content)
    sniff_file(folder / "a.csv")


def _settings(folder: Path, content: bytes) -> None:
    (folder / "campaign.toml").write_bytes(content)
    try:
        open_campaign(folder).validated()
    except CampaignFaults as faults:
        str(faults)


def _model(reader: Callable[[str], object]) -> Callable[[Path, bytes], None]:
    def call(folder: Path, content: bytes) -> None:
        try:
            reader(content.decode())
        except (ValueError, RecursionError):  # errors that callers are shown
            return

    return call


# What reads the bytes, and the campaign and file that seeds come from.
TARGETS: dict[str, tuple[Callable[[Path, bytes], None], str, str]] = {
    "csv": (_table("points.csv"), "telescope", "points.csv"),
    "guessed": (_table("p.csv", separator=None, thousands=",", missing=["", "-"]), "telescope", "targets.csv"),
    "parquet": (_table("points.parquet"), "telescope-parquet", "targets.parquet"),
    "gz": (_table("points.csv.gz"), "packed", "points.csv.gz"),
    "trc": (_table("p.trc", **_MAPPED), "trc", "p.trc"),
    "vstars": (_table("p.txt", format="vstars", **_MAPPED), "vstars", "p1.txt"),
    "rtl": (_table("x.rtl", "positioning"), "rtl", "x.rtl"),
    "c3d": (_table("p.c3d", constants={"body": "b"}), "c3d", "p.c3d"),
    "ply": (_table("p.ply", **_MAPPED), "ply-bytes", "p1.ply"),
    "pcd": (_table("p.pcd", **_MAPPED), "pcd-text", "p1.pcd"),
    "init": (_looked_at, "telescope", "points.csv"),
    "toml": (_settings, "mapped", "campaign.toml"),
    "model": (_model(read_model), "started-telescope", "model.toml"),
    "sensor": (_model(read_sensor), "started-bench", "model.toml"),
}


def main() -> None:
    """Fuzz one target until one of libFuzzer's bounds is met."""
    name, words = sys.argv[1], sys.argv[2:]
    call, campaign, file = TARGETS[name]
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as place:
        seeds, folder = Path(place) / "seeds", Path(place) / "c"
        seeds.mkdir()
        folder.mkdir()
        good = more_files(campaign)[file]
        (seeds / "good").write_bytes(good)
        (seeds / "short").write_bytes(good[:2000])

        def one(content: bytes) -> None:
            call(folder, content)

        child = os.fork()  # which libFuzzer ends without a word to Python
        if not child:
            atheris.Setup([sys.argv[0], *_BOUNDS, *words, str(seeds)], one)
            atheris.Fuzz()
        sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))


if __name__ == "__main__":
    main()
