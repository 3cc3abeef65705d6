"""Freshness of stages depends on contents only, not on clocks or paths, and every reason is reported."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.pipeline.fake_project import STAGES, FakeProject
from tests.sentences import assert_says

ALL = list(STAGES)


def toml(old: str, new: str) -> Callable[[FakeProject], None]:
    return lambda fake: fake.edit(fake.campaign / "campaign.toml", old, new)


def source(file: str, old: str, new: str) -> Callable[[FakeProject], None]:
    return lambda fake: fake.edit(fake.root / file, old, new)


def write(file: str, text: str) -> Callable[[FakeProject], None]:
    def act(fake: FakeProject) -> None:
        (fake.root.parent / file).write_text(text)

    return act


def touch_everything(fake: FakeProject) -> None:
    for path in (*fake.root.rglob("*.py"), *fake.campaign.iterdir(), *fake.out.glob("*.*")):
        os.utime(path)


def copy_the_run_folder(fake: FakeProject) -> None:
    shutil.copytree(fake.out, fake.out.with_name("copy"))
    shutil.rmtree(fake.out)
    fake.out.with_name("copy").rename(fake.out)


def lose_the_ledger(fake: FakeProject) -> None:
    shutil.rmtree(fake.out / ".truing")


def check_out_anew(fake: FakeProject) -> None:
    for place in (fake.campaign, fake.root):
        fresh = place.with_name(f"{place.name}-fresh")
        shutil.copytree(place, fresh, copy_function=shutil.copy)
        shutil.rmtree(place)
        fresh.rename(place)


def remove(name: str) -> Callable[[FakeProject], None]:
    return lambda fake: (fake.out / name).unlink()


def flip_a_byte(fake: FakeProject) -> None:
    path = fake.out / "residuals.parquet"
    content = bytearray(path.read_bytes())
    content[40] ^= 1
    path.write_bytes(content)


REORDERED = (
    "[noise]\npoint_mm = 0.005\n\n[diagnosis]\nfalse_alarm = 0.05",
    "[diagnosis]\nfalse_alarm=0.05\n[noise]\npoint_mm=5e-3",
)

CHANGES: dict[str, tuple[Callable[[FakeProject], None], list[str], str]] = {
    "touched files": (touch_everything, [], ""),
    "a copied run folder": (copy_the_run_folder, [], ""),
    "a fresh checkout": (check_out_anew, [], ""),
    "a lost ledger": (lose_the_ledger, [], ""),
    "a comment in campaign.toml": (toml("# a comment", "# another"), [], ""),
    "sections in another order": (toml(*REORDERED), [], ""),
    "a setting that no stage reads": (toml("[noise]", "[noise]\nactuator_mm = 0.1"), [], ""),
    "a tolerance": (
        toml("0.005", "0.004"),
        ["pose", "deformation", "diagnose", "calibrate", "report"],
        "noise.point_mm changed from 0.005 to 0.004",
    ),
    "a setting of a late stage": (
        toml("0.05\n", "0.04\n"),
        ["diagnose", "report"],
        "diagnosis.false_alarm changed from 0.05 to 0.04",
    ),
    "a new section": (
        toml("[noise]", "[requirement]\nx_mm = 1.0\n[noise]"),
        ["report"],
        'requirement is new: {"x_mm":1.0}',
    ),
    "a raw value": (lambda f: f.edit(f.campaign / "points.csv", "4.0", "4.5"), ALL, "raw file points.csv changed"),
    "a new raw file": (
        write("campaign/targets.csv", ""),
        ALL,
        "raw file targets.csv is a new input",
    ),
    "a stage's code": (
        source("stages/deformation.py", '"delta_bz_um": 0.0', '"delta_bz_um": 1.0'),
        ["deformation", "diagnose", "calibrate", "report"],
        "source of stages/deformation.py changed",
    ),
    "a function-level import": (
        source("truing/estimation/mean.py", "/ len(values)", "/ len(values) + 1"),
        ["pose", "deformation", "diagnose", "calibrate", "report"],
        "source of truing/estimation/mean.py changed",
    ),
    "a module that nobody imports": (write("project/truing/estimation/unused.py", "x = 1"), [], ""),
    "the pipeline's own code": (source("pipeline/console.py", '"""Output', '"""All output'), [], ""),
    "a missing artifact": (remove("deformation.parquet"), ["deformation"], "deformation.parquet is missing"),
    "a missing last artifact": (remove("report.html"), ["report"], "report.html is missing"),
    "a damaged artifact": (flip_a_byte, ["pose"], "residuals.parquet was changed after it was written"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_reruns_exactly_the_dependent_stages(ran: FakeProject, change: str) -> None:
    act, expected, reason = CHANGES[change]
    act(ran)
    if reason:
        standings = ran.standings()
        assert reason in standings[expected[0]]
        assert [name for name in ALL if not standings[name].startswith("stale")] == _not_behind(expected)
    assert ran.run() == expected


def _not_behind(expected: list[str]) -> list[str]:
    """Stages whose state does not hang on those that rerun, and on those that may follow."""
    reads = {"qa": {"ingest"}, "pose": {"ingest"}, "deformation": {"pose"}, "calibrate": {"deformation"}}
    reads |= {
        "uncertainty": {"ingest"},
        "diagnose": {"qa", "deformation"},
        "report": {"ingest", "qa", "pose", "diagnose"},
    }
    behind = {expected[0]}
    for name in ALL:
        if behind & reads.get(name, set()):
            behind.add(name)
    return [name for name in ALL if name not in behind]


def test_the_model_that_a_campaign_starts_from_is_assessed_by_content(fake: FakeProject) -> None:
    leg = "{ a_mm = [1.0, 0.0, 0.0], b_mm = [1.0, 0.0, 0.0], length_mm = 5.0 }"
    legged = f'[mechanism]\ntype = "ups"\nmodel = "../earlier.toml"\nlegs = [{leg}, {leg}, {leg}]\n\n[noise]'
    earlier = fake.campaign.parent / "earlier.toml"
    earlier.write_text("format = 2\n")
    fake.edit(fake.campaign / "campaign.toml", "[noise]", legged)
    assert fake.run() == ALL
    os.utime(earlier)
    assert fake.run() == []
    earlier.write_text("format = 2  # of another campaign\n")
    assert_says(fake.standings()["ingest"], "../earlier.toml", "changed")
    assert fake.run()[0] == "ingest"


def test_forced_reruns_leave_the_same_bytes(ran: FakeProject) -> None:
    before = {path.name: path.read_bytes() for path in ran.out.glob("[a-z]*")}
    assert len(before) == 14
    assert ran.run("--force") == ALL
    assert {path.name: path.read_bytes() for path in ran.out.glob("[a-z]*")} == before
    assert ran.run() == []


def test_from_runs_the_stage_and_all_after_it(ran: FakeProject) -> None:
    assert ran.run("--from", "diagnose") == ["diagnose", "calibrate", "uncertainty", "report"]


def test_only_runs_the_stage_and_what_it_needs(fake: FakeProject) -> None:
    assert fake.run("--only", "deformation") == ["ingest", "pose", "deformation"]
    assert fake.run("--only", "deformation") == []
    assert fake.run("--only", "deformation", "--force") == ["deformation"]
    assert fake.standings()["qa"].startswith("never run")
    assert fake.run() == ["qa", "diagnose", "calibrate", "uncertainty", "report"]


def test_an_optional_artifact_that_is_no_longer_made_disappears(fake: FakeProject) -> None:
    (fake.campaign / "targets.csv").write_text("")
    fake.run()
    assert (fake.out / "survey.parquet").exists()
    (fake.campaign / "targets.csv").unlink()
    assert fake.run() == ALL
    assert not (fake.out / "survey.parquet").exists()


def test_same_size_and_time_is_seen_through_with_check(fake: FakeProject) -> None:
    points = fake.campaign / "points.csv"
    long_ago = (1_000_000_000_000_000_000, 1_000_000_000_000_000_000)
    os.utime(points, ns=long_ago)
    fake.run()
    fake.edit(points, "4.0", "4.5")
    os.utime(points, ns=long_ago)
    assert fake.run() == []
    assert fake.run("--check") == ALL


def test_a_run_writes_below_its_folder_alone(ran: FakeProject) -> None:
    assert sorted(path.name for path in ran.cwd.iterdir()) == ["runs"]
    assert sorted(path.name for path in ran.out.parent.iterdir()) == ["bench"]
    assert sorted(path.name for path in ran.campaign.iterdir()) == ["campaign.toml", "points.csv"]


def test_out_with_several_campaigns_gives_each_its_own_folder(fake: FakeProject, tmp_path: Path) -> None:
    second = tmp_path / "second"
    shutil.copytree(fake.campaign, second)
    fake.edit(second / "campaign.toml", '"bench"', '"other"')
    fake.run(str(second), "--out", "here")
    found = sorted(path.name for path in (fake.cwd / "here").iterdir())
    assert found == ["bench", "campaigns.html", "campaigns.parquet", "other"]
