"""A run that is killed, interrupted or out of disk space leaves complete artifacts, and the next one continues."""

from __future__ import annotations

import ctypes
import random
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.pipeline.fake_project import STAGES, FakeProject
from truing.pipeline.atomic_file import write_atomically

_PATIENCE_S = 60.0  # where other work shares the processor
posix_only = pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals and limits")


def assert_whole(out: Path) -> None:
    """Every artifact that is there can be read to its end and carries its provenance."""
    for path in out.glob("[a-z]*"):
        if path.suffix == ".parquet":
            assert pq.read_table(path).schema.metadata[b"truing.digest"]
        elif path.suffix == ".toml":
            assert tomllib.loads(path.read_text())["provenance"]["digest"]
        else:
            assert path.read_text().endswith(" -->\n")


def finished(fake: FakeProject) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in fake.out.glob("[a-z]*")}


@posix_only
def test_sigkill_at_random_moments(fake: FakeProject, ran: FakeProject) -> None:
    moments = random.Random(20).sample(range(5, 60), 8)
    expected = finished(ran)
    for hundredth in moments:
        fake.edit(fake.campaign / "campaign.toml", "# ", "# again: ")
        process = subprocess.Popen(
            fake.command("run", str(fake.campaign), "--force"),
            cwd=fake.cwd,
            env=fake.environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        time.sleep(hundredth / 100)
        process.kill()
        process.wait()
        assert_whole(fake.out)
    fake.run()
    assert finished(fake) == expected
    assert not list(fake.out.rglob("*.part"))
    assert fake.run() == []


def start_pausing(fake: FakeProject, seconds: float) -> subprocess.Popen[str]:
    """A run that stands still within its pose stage."""
    process = subprocess.Popen(
        fake.command("run", str(fake.campaign)),
        cwd=fake.cwd,
        env=fake.environment(f"pause{seconds}"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    patience = time.monotonic() + _PATIENCE_S
    while not (fake.cwd / "pausing").exists():
        assert time.monotonic() < patience
        time.sleep(0.02)
    return process


@posix_only
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_says_so_and_the_next_carries_on(fake: FakeProject, number: signal.Signals) -> None:
    process = start_pausing(fake, 2 * _PATIENCE_S)
    process.send_signal(number)
    _, errors = process.communicate(timeout=_PATIENCE_S)
    assert process.returncode == (130 if number == signal.SIGINT else 4)
    assert errors.startswith(f"interrupted ({number.name})")
    assert errors.count("\n") == 1
    assert_whole(fake.out)
    assert fake.run() == ["pose", "deformation", "diagnose", "calibrate", "uncertainty", "report"]


@posix_only
def test_two_runs_exclude_each_other_and_the_second_names_the_first(fake: FakeProject) -> None:
    process = start_pausing(fake, 2 * _PATIENCE_S)
    second = fake.call("run", str(fake.campaign))
    assert second.returncode == 4
    assert f"in use by another run: process {process.pid} on " in second.stderr
    assert " since " in second.stderr
    process.kill()
    process.communicate()
    assert fake.run() == ["pose", "deformation", "diagnose", "calibrate", "uncertainty", "report"]


@posix_only
def test_a_full_disk_ends_with_4_and_keeps_finished_artifacts(ran: FakeProject) -> None:
    before = finished(ran)
    limited = (
        "import resource, signal, sys;"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (900, resource.RLIM_INFINITY));"
        "sys.argv = ['truing', 'run', sys.argv[1], '--force'];"
        "from truing.pipeline.entry import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", limited, str(ran.campaign)],
        cwd=ran.cwd,
        env=ran.environment() | {"PYTHONDONTWRITEBYTECODE": "1"},  # Python leaves a torn one where the disk is full
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 4, done.stderr
    assert "grew beyond what this system or its limits allow" in done.stderr
    assert done.stderr.count("\n") == 1
    assert finished(ran) == before
    assert ran.run() == []


def test_no_space_within_a_stage_is_the_environments(fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign), trouble="full")
    assert done.returncode == 4
    assert "stage pose: the disk is full (residuals.parquet)" in done.stderr
    assert fake.run() == list(STAGES)[2:]


@pytest.mark.parametrize(("trouble", "said"), [("memory", "7.45 TiB"), ("mapping", "libblas.so: failed to map")])
def test_want_of_memory_within_a_stage_is_the_environments(trouble: str, said: str, fake: FakeProject) -> None:
    done = fake.call("run", str(fake.campaign), trouble=trouble)
    assert done.returncode == 4
    assert done.stderr.startswith("stage pose: there is not enough memory (")
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (fake.out / "defect.log").exists()
    assert fake.run() == list(STAGES)[2:]


@posix_only
# At 30 MB the interpreter itself may abort: it finds no memory to report that there is none.
@pytest.mark.parametrize("megabytes", [22, 60, 300, 1500])
@pytest.mark.parametrize("command", ["run", "check", "export"])
def test_a_memory_limit_below_the_need_of_libraries_is_reported(
    command: str, megabytes: int, fake: FakeProject
) -> None:
    limited = (
        "import resource, sys;"
        f"resource.setrlimit(resource.RLIMIT_AS, ({megabytes << 20}, resource.RLIM_INFINITY));"
        f"sys.argv = ['truing', {command!r}, sys.argv[1]];"
        "from truing.pipeline.entry import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", limited, str(fake.campaign)],
        cwd=fake.cwd,
        env=fake.environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=_PATIENCE_S,
    )
    assert done.returncode == 4, done.stderr
    assert "memory" in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(fake.cwd.iterdir()) == []


def test_a_file_in_place_of_the_run_folder(fake: FakeProject) -> None:
    (fake.cwd / "runs").write_text("")
    done = fake.call("run", str(fake.campaign))
    assert done.returncode == 4
    assert "runs/bench cannot be created" in done.stderr.replace("\\", "/")


def _without_roots_privileges() -> None:
    """Let a child of root meet permissions as everybody does (Linux; elsewhere and for others this changes nothing)."""
    drop_bounding, override, read_search = 24, 1, 2
    libc = ctypes.CDLL(None)
    for capability in (override, read_search):
        libc.prctl(drop_bounding, capability, 0, 0, 0)


@posix_only
@pytest.mark.parametrize("place", ["runs", "runs/bench/.truing"])
def test_a_read_only_folder(ran: FakeProject, place: str) -> None:
    folder = ran.cwd / place
    if place == "runs":
        ran.out.rename(ran.cwd / "elsewhere")
    folder.chmod(0o500)
    try:
        done = subprocess.run(
            ran.command("run", str(ran.campaign)),
            cwd=ran.cwd,
            env=ran.environment(),
            capture_output=True,
            text=True,
            check=False,
            preexec_fn=_without_roots_privileges,
        )
    finally:
        folder.chmod(0o700)
    assert done.returncode == 4, done.stderr
    assert "permission is denied" in done.stderr or "is read-only" in done.stderr
    assert done.stderr.count("\n") == 1


def test_leftovers_of_dead_runs_are_removed(ran: FakeProject) -> None:
    (ran.out / ".poses.parquet.part").write_bytes(b"half")
    ran.run()
    assert not list(ran.out.rglob("*.part"))


def test_a_file_makes_the_folder_that_it_lacks(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "plan.csv"
    write_atomically(path, b"pose\n")
    assert path.read_bytes() == b"pose\n"
    assert [own.name for own in path.parent.iterdir()] == ["plan.csv"]
