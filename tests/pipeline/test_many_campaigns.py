"""`truing run` on many campaigns in parallel gives the same output, files and exit code as one after the other."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.pipeline.fake_project import FakeProject
from tests.report.explained import unexplained
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
    """Messages without seconds, without the number of workers, and without the lines of a long wait."""
    return re.sub(r"\d+\.\d\d s$|^run: \d of \d campaigns\n|^\d campaigns: .*\n", "", text, flags=re.MULTILINE)


def all_of(folder: Path) -> list[dict[str, object]]:
    """The table of all campaigns, without processor times, run folders by their names."""
    rows = pq.read_table(folder / "campaigns.parquet").drop_columns(["processor_s"]).to_pylist()
    return [{**row, "run_folder": row["run_folder"] and Path(row["run_folder"]).name} for row in rows]


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.glob("*/*") if path.is_file()}


@pytest.mark.parametrize("way", WAYS)
def test_many_problems_at_a_time_give_the_results_of_single_ones(
    way: str, fake: FakeProject, fresh: FakeProject, campaigns: list[str]
) -> None:
    places = [*campaigns, "nowhere"]
    one = fake.call("run", *places, "--out", str(fresh.cwd / "one"))
    many = fresh.call("run", *places, "--out", str(fresh.cwd / "many"), *WAYS[way])
    assert one.returncode == many.returncode == 2
    assert timeless(many.stdout) == timeless(one.stdout).replace("/one/", "/many/")
    assert many.stderr == one.stderr
    assert bytes_of(fresh.cwd / "many") == bytes_of(fresh.cwd / "one")
    assert all_of(fresh.cwd / "many") == all_of(fresh.cwd / "one")
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
    output = [line for line in done.stderr.splitlines() if "not enough memory" in line]
    assert len(output) == 2
    assert all("stage pose" in line and "ulimit -v" in line for line in output)


def test_a_campaign_locked_by_another_run_is_skipped(fresh: FakeProject, campaigns: list[str]) -> None:
    held = fresh.cwd / "runs" / "first" / PRIVATE
    held.mkdir(parents=True)
    with hold(held / "lock"):
        done = fresh.call("run", campaigns[0], campaigns[4], "--workers", "2")
    assert done.returncode == 4
    assert_says(done.stderr, "another run", "process")
    assert not (held.parent / "report.html").exists()
    assert (fresh.cwd / "runs" / "last" / "report.html").exists()


def test_a_campaign_that_ends_its_worker_ends_no_other(
    fake: FakeProject, fresh: FakeProject, campaigns: list[str]
) -> None:
    fresh.edit(Path(campaigns[0]) / "points.csv", "4.0", "666.0")
    done = fresh.call("run", campaigns[0], campaigns[4], "--workers", "2", trouble="vanish")
    assert done.returncode == 4, done.stderr
    assert_says(done.stderr, "first", "worker", "lost")
    assert (fresh.cwd / "runs" / "last" / "report.html").exists()
    assert fake.call("run", campaigns[0]).returncode == 0, "what was whole is whole still"


def test_the_table_of_all_campaigns_has_a_row_for_each_and_the_worst_first(
    fake: FakeProject, campaigns: list[str]
) -> None:
    fake.call("run", *campaigns, "nowhere", "--out", "several")
    rows = all_of(fake.cwd / "several")
    assert [(row["rank"], Path(str(row["campaign_path"])).name, row["exit_code"]) for row in rows] == [
        *((1, "broken", 2), (2, "taken", 2), (3, "nowhere", 2)),
        *((4, "checked", 3), (5, "first", 0), (6, "last", 0)),
    ]
    by_name = {Path(str(row["campaign_path"])).name: row for row in rows}
    assert_says(str(by_name["broken"]["problem"]), "points.csv", "x_mm", "nan")
    assert by_name["checked"]["failed_checks"] == "size"
    assert by_name["first"]["stages_run"] == 8
    assert by_name["first"]["run_folder"] == "first"
    again = fake.call("run", *campaigns, "--out", "several")
    assert again.returncode == 2
    assert {row["stages_run"] for row in all_of(fake.cwd / "several")} == {0}


def test_the_page_of_all_campaigns_links_reports_and_names_faults(fake: FakeProject, campaigns: list[str]) -> None:
    done = fake.call("run", *campaigns, "--out", "several")
    page = (fake.cwd / "several" / "campaigns.html").read_text()
    links = dict(re.findall(r'<a href="([^"#]+)">([^<]+)</a>', page))
    assert links == {f"{name}/report.html": name for name in ("checked", "first", "last")}
    assert all((fake.cwd / "several" / link).is_file() for link in links)
    assert "points.csv, row 3, column x_mm" in page
    assert not unexplained(page)
    assert_says(done.stdout, "all campaigns", "campaigns.html", "campaigns.parquet")


def test_one_campaign_alone_leaves_no_table_of_all(fake: FakeProject, campaigns: list[str]) -> None:
    fake.call("run", campaigns[0], "--out", "single")
    assert not list(fake.cwd.rglob("campaigns.*"))


@pytest.mark.parametrize("name", ["campaigns.parquet", "campaigns.html", "campaign.toml"])
def test_a_foreign_file_is_not_overwritten_by_the_table_of_all(
    name: str, fake: FakeProject, campaigns: list[str]
) -> None:
    (fake.cwd / "several").mkdir()
    (fake.cwd / "several" / name).write_text("measured by hand")
    done = fake.call("run", campaigns[0], campaigns[4], "--out", "several")
    assert done.returncode == 2
    assert_says(done.stderr, "--out", "several")
    assert [path.name for path in (fake.cwd / "several").iterdir()] == [name]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="SIGKILL is a signal of POSIX systems")
@pytest.mark.parametrize("way", WAYS)
def test_a_worker_killed_while_it_runs_loses_nothing(way: str, fake: FakeProject, fresh: FakeProject) -> None:
    places = []
    for number in range(4):
        places.append(str(fresh.campaign.with_name(f"c{number}")))
        shutil.copytree(fresh.campaign, places[-1])
        fresh.edit(Path(places[-1]) / "campaign.toml", '"bench"', f'"c{number}"')
    fake.call("run", *places, "--out", "whole")
    words = fresh.command("run", *places, "--out", "killed", *WAYS[way])
    with subprocess.Popen(
        words, cwd=fresh.cwd, env=fresh.environment("pause1"), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as call:
        killed = _kill_a_worker(fresh.cwd / "killed", call)
        output, problems = call.communicate(timeout=120)
    assert killed != call.pid
    assert call.returncode == 0, output + problems
    assert bytes_of(fresh.cwd / "killed") == bytes_of(fresh.cwd / "whole")
    assert [row["exit_code"] for row in all_of(fresh.cwd / "killed")] == [0, 0, 0, 0]


def _kill_a_worker(out: Path, call: subprocess.Popen[str]) -> int:
    """Kill, by SIGKILL, the first process that is within the stage ``pose`` of a campaign; returns its number."""
    until = time.monotonic() + 60
    while time.monotonic() < until and call.poll() is None:
        for lock in out.glob(f"*/{PRIVATE}/lock"):
            waiting = (out.parent / "pausing").exists() and (lock.parent.parent / "qa.parquet").exists()
            if waiting and (found := re.search(r'"pid": (\d+)', lock.read_text())):
                os.kill(int(found[1]), signal.SIGKILL)
                return int(found[1])
        time.sleep(0.02)
    raise AssertionError(f"no worker was seen at work: {call.communicate()}")


def test_an_invalid_scheduler_address_is_refused_at_once(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign), "--scheduler", "example.org")
    assert done.returncode == 2
    assert_says(done.stderr, "tcp://host:port", "tls://host:port", "local")
    assert list(fake.cwd.iterdir()) == []
