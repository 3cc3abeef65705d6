"""The packages of docs/own-check.md, own-format.md, own-instrument.md and own-section.md do what the pages say."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import PROJECT
from tests.docs.installed_page import install_page
from tests.formats.reading import read
from tests.stages.line import run_line
from tests.tolerance import assert_close
from truing.report.sections import build_sections, page_sections, tables_read
from truing.schemas.campaign import read_campaign
from truing.schemas.quality_checks import CHECKS, checks_of

POINTS = {"P01": (100.002, 0.011, 50.003), "P02": (-99.987, 0.008, 50.001), "P03": (0.004, 120.01, 49.998)}
PAGES = ("own-cause", "own-mechanism", "own-loops", "own-instrument", "own-format", "own-check", "own-section")


def _page(name: str) -> str:
    return (PROJECT / "docs" / f"{name}.md").read_text(encoding="utf-8")


def _points_of(page: str, file: str, language: str, folder: Path) -> tuple[Any, dict[str, Any]]:
    """The file of a page as the table points, and the page's entry of campaign.toml."""
    (text,) = re.findall(rf"^`{re.escape(file)}`\n\n```{language}\n(.*?)```", page, re.M | re.S)
    folder.mkdir()
    (folder / file).write_text(text, encoding="utf-8")
    (entry,) = [
        document["files"]["points"]
        for document in map(tomllib.loads, re.findall(r"```toml\n(.*?)```", page, re.S))
        if "files" in document
    ]
    return read(folder, "points", entry), entry


@pytest.mark.parametrize("name", PAGES)
def test_pages_are_short(name: str) -> None:
    """Words of text and tables; the code of the example comes on top."""
    text = re.sub(r"```.*?```", "", _page(name), flags=re.S)
    assert len(re.findall(r"\w[\w'-]*", text)) < 600


@pytest.mark.parametrize(
    ("name", "file", "language", "pose", "sigma"),
    [("own-instrument", "arm_07.txt", "text", 7, 0.004), ("own-format", "pose_3.json", "json", 3, None)],
)
def test_a_format_of_a_page_reads_its_file(
    name: str,
    file: str,
    language: str,
    pose: int,
    sigma: float | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    install_page(_page(name), tmp_path / "site", monkeypatch)
    found, _ = _points_of(_page(name), file, language, tmp_path / "campaign")
    assert found.faults == ()
    assert found.columns["target"] == list(POINTS)
    assert found.columns["pose"] == [pose] * 3
    assert found.columns["body"] == ["platform"] * 3
    for k, axis in enumerate("xyz"):
        assert_close(found.columns[f"{axis}_mm"], [point[k] for point in POINTS.values()], atol=1e-12, what=axis)
    if sigma is not None:
        assert_close(found.columns["sigma_x_mm"], [sigma] * 3, atol=1e-12, what="sigma")


def test_a_damaged_file_of_an_installed_format_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_page(_page("own-format"), tmp_path / "site", monkeypatch)
    _, entry = _points_of(_page("own-format"), "pose_3.json", "json", tmp_path / "campaign")
    (tmp_path / "campaign" / "pose_3.json").write_text('{"points": [{"id": "P01"}]}', encoding="utf-8")
    (fault,) = read(tmp_path / "campaign", "points", entry).faults
    assert fault.file == "pose_3.json"
    assert "points" in fault.expected


def test_without_the_package_a_format_is_a_fault_that_names_the_others() -> None:
    document = {
        "campaign": {"name": "c", "kind": "photogrammetry"},
        "files": {"points": {"path": "a.txt", "format": "lab-arm"}},
    }
    with pytest.raises(Exception, match="vstars") as fault:
        read_campaign(document)
    assert "lab-arm" in str(fault.value)


def test_a_preset_with_an_unknown_key_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = _page("own-instrument").replace('"decimal": ","', '"decimal_mark": ","')
    install_page(page, tmp_path / "site", monkeypatch)
    with pytest.raises(ValueError, match="decimal_mark"):
        _points_of(page, "arm_07.txt", "text", tmp_path / "campaign")


@pytest.fixture
def paced(workplace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The sample cut short, with the package of own-check.md installed."""
    install_page(_page("own-check"), tmp_path / "site", monkeypatch)
    return Path(shutil.copytree(workplace / "sample_data" / "telescope", tmp_path / "campaign"))


def _rows_of_pace(folder: Path) -> list[dict[str, Any]]:
    tables, _ = run_line(folder, "ingest", "qa")
    return [row for row in tables["qa"].to_pylist() if row["check"] == "pace"]


def test_a_check_of_the_page_has_its_row_with_the_limits_of_the_campaign(paced: Path) -> None:
    assert {"pace"} == {*checks_of("photogrammetry")} - {*CHECKS["photogrammetry"]}
    assert "pace" not in checks_of("interferometer")
    (row,) = _rows_of_pace(paced)
    assert 1.0 < row["value"] < 4.0  # the sample cut short leaves long gaps between its poses
    assert (row["verdict"], row["limit"], row["unit"]) == ("warn", 4.0, "1/h")
    (limits,) = [text for text in re.findall(r"```toml\n(.*?)```", _page("own-check"), re.S) if "qa.limits" in text]
    own = paced / "campaign.toml"
    plain = own.read_text(encoding="utf-8")
    own.write_text(f"{plain}\n{limits}", encoding="utf-8")
    (stricter,) = _rows_of_pace(paced)
    assert (stricter["verdict"], stricter["limit"]) == ("warn", 10.0)
    assert "the hall warms up in the morning" in stricter["message"]
    own.write_text(f"{plain}\n{limits.replace('warn = 10', 'warn = 1')}", encoding="utf-8")
    assert [row["verdict"] for row in _rows_of_pace(paced)] == ["pass"]


def test_a_check_with_a_name_in_use_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_page(_page("own-check").replace('name = "pace"\n', 'name = "noise"\n'), tmp_path / "site", monkeypatch)
    with pytest.raises(ValueError, match="check noise: found in two places"):
        checks_of("photogrammetry")


def test_a_section_of_the_page_is_in_the_report(
    workplace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {section.name for section in page_sections()}
    install_page(_page("own-section"), tmp_path / "site", monkeypatch)
    assert {section.name for section in page_sections()} - before == {"temperature"}
    assert "configurations" in tables_read()
    tables, _ = run_line(workplace / "sample_data" / "telescope", "ingest")
    frames = {name: table.to_pandas() for name, table in tables.items()}
    shown = [section.id for section in build_sections(frames, {})]
    assert shown[-3:] == ["temperature", "provenance", "glossary"]
    cold = {**frames, "configurations": frames["configurations"].drop(columns="temperature_c")}
    assert "temperature" not in [section.id for section in build_sections(cold, {})]


def test_readme_index_and_architecture_link_to_every_page() -> None:
    for place in (PROJECT / "README.md", PROJECT / "docs" / "index.md"):
        text = place.read_text(encoding="utf-8")
        assert [name for name in PAGES if f"{name}.md" not in text] == []
