"""`truing watch`: rounds after changes, incomplete files, the page, and the end."""

from __future__ import annotations

import http.client
import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tests.blind.generator.arms import draw, write
from truing.estimation.repeated_looks import Look
from truing.pipeline.command_line import app
from truing.pipeline.run_folder import PRIVATE
from truing.pipeline.watch_command import _changes, _KeptLooks, _Watch
from truing.pipeline.watch_page import WatchServer, serving
from truing.report.watching import (
    Enough,
    RequirementLook,
    requirement_look,
    watched,
)

NOW = datetime(2026, 3, 1, 12, 0, 0)
PATIENCE_S = 60.0  # where other work shares the processor


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small campaign of an arm, whose requirement is loose enough to be decided."""
    folder = tmp_path_factory.mktemp("arm") / "arm"
    write(draw(3, instrument="points-campaign", causes=(), poses=40), folder)
    file = folder / "campaign.toml"
    file.write_text(f"{file.read_text(encoding='utf-8')}\n[requirement]\nx_mm = 5.0\n", encoding="utf-8")
    return folder


def _tables(
    reason: str, state: str = "ok", section: str = "requirements", adequacy: str = "ok"
) -> dict[str, pd.DataFrame]:
    row = {"section": section, "state": state, "reason_code": reason, "explanation": "Told.", "value": np.nan}
    model = row | {"section": "adequacy", "state": adequacy, "reason_code": "within-noise"}
    return {"verdict": pd.DataFrame([one | {"unit": None, "limit": np.nan} for one in (model, row)])}


@pytest.mark.parametrize(
    ("tables", "expected"),
    [
        (_tables("met"), Enough.TO_CONFIRM),
        (_tables("not-met", "fails"), Enough.TO_CONFIRM),
        (_tables("not-met", "fails", adequacy="fails"), Enough.NOT_JUDGED),
        (_tables("undecided", "attention"), Enough.NOT_ENOUGH),
        (_tables("model-does-not-fit", "not tested"), Enough.NOT_JUDGED),
        (_tables("not-evaluated", "not tested"), Enough.NOT_STATED),
        (_tables("belong", "ok", "belonging"), Enough.NOT_STATED),
        (_tables("do-not-belong", "fails", "belonging"), Enough.NOT_JUDGED),
        ({}, Enough.NOT_JUDGED),
    ],
)
def test_enough_is_what_the_verdict_on_requirements_says(tables: dict[str, pd.DataFrame], expected: Enough) -> None:
    assert watched("arm", 1, NOW, tables, ()).enough is expected


@pytest.mark.parametrize("reason", ["met", "not-met"])
def test_a_confirmed_decision_is_enough_and_another_says_what_confirms_it(reason: str) -> None:
    state = watched("arm", 1, NOW, _tables(reason, "ok" if reason == "met" else "fails"), ())
    assert replace(state, is_confirmed=True, poses_to_confirm=45).enough is Enough.ENOUGH
    open_one = replace(state, poses_to_confirm=30)
    assert open_one.facts()["poses_to_confirm"] == 30
    assert "30 compared poses" in open_one.line
    assert replace(state, is_confirmed=True, poses_to_confirm=45).facts()["poses_to_confirm"] is None


def _required(**rows: tuple[str, int, float]) -> pd.DataFrame:
    """Requirements of a chain by component: verdict, compared poses and p-value."""
    common = {"model": "extended", "deformation": "none", "error": 1.0, "requirement": 1.0}
    facts = ("verdict", "poses_judged", "p_value")
    return pd.DataFrame(
        [common | {"component": name} | dict(zip(facts, row, strict=True)) for name, row in rows.items()]
    )


def test_the_least_certain_requirement_and_the_fewest_poses_count() -> None:
    joints = {"joints": pd.DataFrame({"joint": ["a"]})}
    both = _required(x=("meets", 20, 0.001), y=("meets", 12, 0.03))
    found = requirement_look(_tables("met") | joints | {"requirements": both})
    assert found == RequirementLook(12, "met", 0.03)
    one = _required(x=("fails", 20, 0.01), y=("meets", 20, 0.03))
    assert requirement_look(_tables("not-met", "fails") | joints | {"requirements": one}) == RequirementLook(
        20, "not-met", 0.02
    )
    assert requirement_look(_tables("not-met", "fails", adequacy="fails") | joints | {"requirements": one}) is None


def test_looks_are_kept_for_another_watch_of_the_same_requirement(tmp_path: Path) -> None:
    looks = [Look(20, "met", 0.001), Look(30, "met", 0.002)]
    (tmp_path / "looks").write_text("damaged")
    kept = _KeptLooks(tmp_path / "looks", {"x_mm": 1.0})
    assert kept.read() == ()
    kept.write(looks)
    assert list(kept.read()) == looks
    assert _KeptLooks(tmp_path / "looks", {"x_mm": 2.0}).read() == ()


def test_faults_leave_nothing_assessed() -> None:
    state = watched("arm", 2, NOW, _tables("met"), ("points.csv: row 3", "points.csv: row 4"))
    assert state.enough is Enough.NOT_JUDGED
    assert state.facts()["faults"] == ["points.csv: row 3", "points.csv: row 4"]
    assert "points.csv: row 3 (and 1 further fault)" in state.line


def test_a_decision_ends_the_watch_when_a_look_with_half_as_many_more_poses_confirms_it(
    arm: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    words = ["watch", str(arm), "--json", "--no-page", "--interval", "0.1", "--out", str(run)]
    reported = json.loads(CliRunner().invoke(app, [*words, "--once"]).stdout)
    assert reported["enough"] == "to confirm"
    assert {row["section"]: row["reason_code"] for row in reported["verdicts"]}["requirements"] == "met"
    assert (run / "report.html").is_file()
    looks = run / PRIVATE / "looks.json"
    first = json.loads(looks.read_text())
    (look,) = first["looks"]
    assert reported["poses_to_confirm"] == math.ceil(1.5 * look["count"])
    look["count"] = math.floor(look["count"] / 1.5)  # as if the first look had been earlier
    looks.write_text(json.dumps(first))
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    (line,) = done.stdout.splitlines()
    assert json.loads(line)["enough"] == "enough"


def test_a_folder_that_is_still_empty_is_watched_and_one_that_does_not_exist_is_not(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    done = CliRunner().invoke(app, ["watch", str(tmp_path / "empty"), "--once", "--json", "--interval", "0.1"])
    assert done.exit_code == 2
    assert "truing init" in json.loads(done.stdout)["faults"][0]
    missing = CliRunner().invoke(app, ["watch", str(tmp_path / "none"), "--once"])
    assert missing.exit_code == 2
    assert not (tmp_path / "none").exists()


def _rounds(folder: Path, changes: list[Path], out: Path | None = None) -> Iterator[int]:
    """Numbers of the looks at which files count as changed; between looks the files of ``changes`` grow in turn."""
    looks = 0

    def sleep(_: float) -> None:
        nonlocal looks
        looks += 1
        if looks > 12:
            raise StopIteration
        if changes:
            with changes.pop(0).open("a") as stream:
                stream.write(".")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("truing.pipeline.watch_command.time.sleep", sleep)
        try:
            for _ in _changes(_Watch(folder, out), 1.0):
                yield looks
        except RuntimeError:  # StopIteration within a generator
            return


def test_a_file_that_is_being_written_is_waited_for(tmp_path: Path) -> None:
    points = tmp_path / "points.csv"
    points.write_text("pose,x_mm\n")
    assert list(_rounds(tmp_path, [points] * 5)) == [6]


def test_watch_runs_one_round_per_change(tmp_path: Path) -> None:
    points, other = tmp_path / "points.csv", tmp_path / "notes.txt"
    points.write_text("pose,x_mm\n")
    assert list(_rounds(tmp_path, [])) == [1]
    quiet = tmp_path / ".hidden"
    assert list(_rounds(tmp_path, [quiet] * 5)) == [1]
    assert list(_rounds(tmp_path, [other])) == [2]


def test_the_run_folder_is_not_watched(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (tmp_path / "points.csv").write_text("pose,x_mm\n")
    assert list(_rounds(tmp_path, [run / "qa.parquet"] * 5, run)) == [1]


def test_a_deleted_file_is_a_change(tmp_path: Path) -> None:
    points = tmp_path / "points.csv"
    points.write_text("pose,x_mm\n")
    looks = 0

    def sleep(_: float) -> None:
        nonlocal looks
        looks += 1
        if looks == 4:
            points.unlink()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("truing.pipeline.watch_command.time.sleep", sleep)
        changes = _changes(_Watch(tmp_path, None), 1.0)
        assert [next(changes, looks) or looks for _ in range(2)] == [1, 5]


def test_a_file_that_the_campaign_reads_in_another_folder_is_watched(tmp_path: Path) -> None:
    folder, points = tmp_path / "campaign", tmp_path / "exports" / "points.csv"
    folder.mkdir()
    points.parent.mkdir()
    points.write_text("pose,x_mm\n")
    text = '[campaign]\nname = "far"\nkind = "photogrammetry"\n[files.points]\npath = "../exports/*.csv"\n'
    (folder / "campaign.toml").write_text(text)
    assert list(_rounds(folder, [points] * 5)) == [6]


@pytest.fixture
def server(tmp_path: Path) -> Iterator[WatchServer]:
    (tmp_path / "report.html").write_text("<p>whole page</p>")
    (tmp_path / "secret.txt").write_text("secret")
    with serving(None) as own:
        own.show(watched("arm <1>", 7, NOW, _tables("undecided", "attention"), ()), tmp_path)
        yield own


def _answer(server: WatchServer, path: str, method: str = "GET", host: str = "127.0.0.1") -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=PATIENCE_S)
    connection.request(method, path, headers={"Host": host})
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


def test_the_page_shows_the_round_and_leads_to_the_report(server: WatchServer) -> None:
    code, page = _answer(server, "/")
    assert code == 200
    assert "Not enough yet" in page
    assert "arm &lt;1&gt;" in page
    assert 'data-round="7"' in page
    assert _answer(server, "/round") == (200, "7")
    assert _answer(server, "/report.html") == (200, "<p>whole page</p>")
    assert _answer(server, "/", "HEAD") == (200, "")


@pytest.mark.parametrize(
    "path",
    ["/secret.txt", "/../secret.txt", "/%2e%2e/secret.txt", "/report.html/../secret.txt", "//etc/passwd", "/.truing"],
)
def test_the_watch_server_serves_no_other_file(server: WatchServer, path: str) -> None:
    code, text = _answer(server, path)
    assert code == 404
    assert "secret" not in text.replace(path, "")


def test_a_link_in_the_place_of_the_report_is_not_followed(server: WatchServer, tmp_path: Path) -> None:
    (tmp_path / "report.html").unlink()
    assert _answer(server, "/report.html")[0] == 404
    try:
        (tmp_path / "report.html").symlink_to(tmp_path / "secret.txt")
    except OSError:
        pytest.skip("this system makes no links")
    assert _answer(server, "/report.html")[0] == 404


def test_an_open_page_loads_the_last_round_before_the_end(server: WatchServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("truing.pipeline.watch_page.SECONDS_BETWEEN_LOOKS", PATIENCE_S)
    start = time.monotonic()
    server.wait_for_reader()  # nobody has looked
    _answer(server, "/")
    server.show(watched("arm", 8, NOW, _tables("met"), ()), None)
    looked = threading.Event()

    def look() -> None:
        looked.set()
        _answer(server, "/")

    late = threading.Timer(0.3, look)
    late.start()
    server.wait_for_reader()
    assert looked.is_set()
    assert time.monotonic() - start < 2.0 * PATIENCE_S
    late.join()


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_the_watch_server_refuses_every_method_but_get(server: WatchServer, method: str) -> None:
    assert _answer(server, "/", method)[0] == 501


def test_the_watch_server_answers_local_hosts_only(server: WatchServer) -> None:
    assert server.server_address[0] == "127.0.0.1"
    assert _answer(server, "/", host="attacker.example")[0] == 403
    assert _answer(server, "/", host=f"localhost:{server.server_address[1]}")[0] == 200


def test_a_port_in_use_is_reported_with_the_cure(arm: Path, tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = CliRunner().invoke(app, ["watch", str(arm), "--port", str(port), "--out", str(tmp_path / "run")])
    assert done.exit_code == 4
    assert f"port {port} is in use" in done.output
    assert "--port" in done.output
    assert not (tmp_path / "run").exists()


def _started(folder: Path, run: Path) -> subprocess.Popen[str]:
    words = ["watch", str(folder), "--json", "--no-page", "--interval", "0.2", "--out", str(run)]
    program = [sys.executable, "-m", "truing.pipeline", *words]
    return subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _next_round(started: subprocess.Popen[str]) -> dict[str, Any]:
    assert started.stdout is not None
    reported: dict[str, Any] = json.loads(started.stdout.readline())
    return reported


def test_an_empty_folder_becomes_a_campaign_with_half_a_file_and_then_a_decided_one(arm: Path, tmp_path: Path) -> None:
    folder = tmp_path / "arm"
    folder.mkdir()
    whole = (arm / "points.csv").read_bytes()
    with _started(folder, tmp_path / "run") as started:
        assert "truing init" in _next_round(started)["faults"][0]
        for file in sorted(arm.iterdir()):
            content = whole[: len(whole) // 2 - 3] if file.name == "points.csv" else file.read_bytes()
            (folder / file.name).write_bytes(content)
        half = _next_round(started)
        while not any("points.csv" in fault for fault in half["faults"]):  # files came one by one
            half = _next_round(started)
        assert half["enough"] == "not judged"
        (folder / "points.csv").unlink()
        assert any("points" in fault for fault in _next_round(started)["faults"])
        (folder / "points.csv").write_bytes(whole)
        assert _next_round(started)["enough"] == "to confirm"
        started.terminate()


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_ends_it_within_a_round(arm: Path, tmp_path: Path) -> None:
    with _started(arm, tmp_path / "run") as started:
        until = time.monotonic() + PATIENCE_S
        while not (tmp_path / "run" / ".truing").is_dir() and time.monotonic() < until:
            time.sleep(0.02)
        os.kill(started.pid, signal.SIGINT)
        reported, output = started.communicate(timeout=PATIENCE_S)
    assert started.returncode == 130
    assert reported == ""
    assert "Traceback" not in output


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_ends_it_between_rounds_and_new_data_start_another(arm: Path, tmp_path: Path) -> None:
    """Points come in two parts; with the first the requirement is not stated."""
    folder = shutil.copytree(arm, tmp_path / "arm")
    file = folder / "campaign.toml"
    file.write_text(file.read_text(encoding="utf-8").split("[requirement]")[0], encoding="utf-8")
    with _started(folder, tmp_path / "run") as started:
        first = _next_round(started)
        assert first["enough"] == "not stated"
        with file.open("a", encoding="utf-8") as stream:
            stream.write("this is no TOML")
        second = _next_round(started)
        assert second["round"] == 2
        assert "valid TOML" in second["faults"][0]
        time.sleep(0.3)
        os.kill(started.pid, signal.SIGINT)
        assert started.wait(timeout=PATIENCE_S) == 130
