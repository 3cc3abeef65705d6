"""`truing run` on many campaigns at a time: what it says, leaves and returns is what it is one after the other."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.pipeline.fake_project import FakeProject
from tests.sentences import assert_says
from truing.pipeline.run_folder import PRIVATE, hold

WAYS = {"processes": ("--workers", "2"), "dask": ("--workers", "2", "--scheduler", "local")}


@pytest.fixture
def fresh(fake: FakeProject) -> FakeProject:
    """The tiny project, each call in a Python of its own, as workers need it."""
    return replace(fake, warm=None)


@pytest.fixture
def campaigns(fake: FakeProject) -> list[str]:
    """A good one, one with a failing check, one that cannot be used, one of a taken name, and a good one again."""
    places = []
    for name in ("first", "checked", "broken", "taken", "last"):
        place = fake.campaign.parent / name
        shutil.copytree(fake.campaign, place)
        fake.edit(place / "campaign.toml", '"bench"', f'"{"first" if name == "taken" else name}"')
        places.append(str(place))
    fake.edit(Path(places[1]) / "points.csv", "4.0", "4000.0")
    fake.edit(Path(places[2]) / "points.csv", "4.0", "nan")
    return places


_TAKES_4_GB = """def run(tables, settings, progress):
    bytearray(4 << 30)"""


def timeless(text: str) -> str:
    """What is said, without seconds and without the lines that a long wait is passed with."""
    return re.sub(r"\d+\.\d\d s$|^run: \d of \d campaigns\n", "", text, flags=re.MULTILINE)


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.glob("*/*") if path.is_file()}


@pytest.mark.parametrize("way", WAYS)
def test_many_at_a_time_are_as_one_after_the_other(way: str, fresh: FakeProject, campaigns: list[str]) -> None:
    places = [*campaigns, "nowhere"]
    one = fresh.call("run", *places, "--out", str(fresh.cwd / "one"))
    many = fresh.call("run", *places, "--out", str(fresh.cwd / "many"), *WAYS[way])
    assert one.returncode == many.returncode == 2
    assert timeless(many.stdout) == timeless(one.stdout).replace("/one/", "/many/")
    assert many.stderr == one.stderr
    assert bytes_of(fresh.cwd / "many") == bytes_of(fresh.cwd / "one")
    assert {path.parts[0] for path in map(Path, bytes_of(fresh.cwd / "many"))} == {"first", "checked", "last"}


@pytest.mark.skipif(sys.platform == "win32", reason="ulimit -v is a limit of POSIX systems")
def test_workers_that_meet_a_limit_of_memory_end_and_say_so(fresh: FakeProject, campaigns: list[str]) -> None:
    """Each process has the limit of its parent; a stage that needs more ends with the cause, and nothing hangs."""
    fresh.edit(fresh.root / "stages/pose.py", "def run(tables, settings, progress):", _TAKES_4_GB)
    limited = (
        "import resource, sys;"
        f"resource.setrlimit(resource.RLIMIT_AS, ({2500 << 20}, resource.RLIM_INFINITY));"
        "sys.argv = ['truing', *sys.argv[1:]];"
        "from truing.pipeline.entry import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", limited, "run", campaigns[0], campaigns[-1], "--out", "several", "--workers", "2"],
        cwd=fresh.cwd,
        env=fresh.environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 4, done.stderr
    said = [line for line in done.stderr.splitlines() if "not enough memory" in line]
    assert len(said) == 2
    assert all("stage pose" in line and "ulimit -v" in line for line in said)


def test_a_campaign_locked_by_another_run_is_skipped(fresh: FakeProject, campaigns: list[str]) -> None:
    held = fresh.cwd / "runs" / "first" / PRIVATE
    held.mkdir(parents=True)
    with hold(held / "lock"):
        done = fresh.call("run", campaigns[0], campaigns[4], "--workers", "2")
    assert done.returncode == 4
    assert_says(done.stderr, "another run", "process")
    assert not (held.parent / "report.html").exists()
    assert (fresh.cwd / "runs" / "last" / "report.html").exists()


def test_a_campaign_that_ends_its_worker_ends_no_other(fresh: FakeProject, campaigns: list[str]) -> None:
    fresh.edit(Path(campaigns[0]) / "points.csv", "4.0", "666.0")
    done = fresh.call("run", campaigns[0], campaigns[4], "--workers", "2", trouble="vanish")
    assert done.returncode == 4, done.stderr
    assert_says(done.stderr, "first", "worker", "lost")
    assert (fresh.cwd / "runs" / "last" / "report.html").exists()
    assert fresh.call("run", campaigns[0]).returncode == 0, "what was whole is whole still"


def test_an_invalid_scheduler_address_is_refused_at_once(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign), "--scheduler", "example.org")
    assert done.returncode == 2
    assert_says(done.stderr, "tcp://host:port", "tls://host:port", "local")
    assert list(fake.cwd.iterdir()) == []
