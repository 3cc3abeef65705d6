"""Python files next to the data are never executed by a command or its workers."""

from __future__ import annotations

import importlib.metadata
import json
import os
import shutil
import site
import subprocess
import sys
import sysconfig
from functools import cache
from pathlib import Path

import pytest

from tests.conftest import PROJECT
from tests.cut_telescope import cut_telescope
from tests.formats.test_other_formats import write_c3d
from tests.packaging.source_tree import PACKAGES
from tests.pipeline.test_plan_command import CAMPAIGN, TARGETS

# As the script `truing` is: its own folder is the first on the path.
_DRIVER = """
import json, sys

if __name__ == "__main__":
    from truing.pipeline.entry import main

    codes = []
    for words in json.loads(sys.argv[1]):
        sys.argv = ["truing", *words]
        try:
            main()
        except SystemExit as end:
            codes.append(end.code or 0)
    # A module that Cython has compiled enters itself a second time, without its package; nothing is looked for by that.
    sought = {name: getattr(getattr(m, "__spec__", None), "name", name) for name, m in sys.modules.items()}
    files = {sought[n].partition(".")[0] for n, module in sys.modules.items() if getattr(module, "__file__", None)}
    print(json.dumps([codes, sorted(files)]))
"""
_STARTS_PROCESSES = ("multiprocessing", "subprocess", "ProcessPoolExecutor", "LocalCluster")


@cache
def _names() -> frozenset[str]:
    """Names that can be imported here: of the standard library, of installed packages, and of the project."""
    installed = importlib.metadata.packages_distributions()
    built = sysconfig._get_sysconfigdata_name()  # type: ignore[attr-defined]
    # what an editable installation leaves next to the packages is named in no list of theirs
    beside = (path.stem for folder in site.getsitepackages() for path in Path(folder).glob("*.py"))
    return frozenset(
        (*sys.stdlib_module_names, *installed, *beside, *PACKAGES, "sitecustomize", "usercustomize", built)
    )


def _plant(folder: Path, mark: Path) -> None:
    """Leave a module of every name, which makes a mark where it is run."""
    for name in _names():
        (folder / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').write({name!r} + '\\n')\n")


@pytest.fixture
def planted(tmp_path: Path) -> Path:
    """A folder with the campaigns ``one`` and ``two`` and markers in ``three``, code of every name next to the data."""
    for name in ("one", "two", "three"):
        campaign = cut_telescope(tmp_path / name)
        text = (campaign / "campaign.toml").read_text()
        (campaign / "campaign.toml").write_text(text.replace('name = "telescope"', f'name = "{name}"'))
        _plant(campaign, tmp_path / "mark")
    (tmp_path / "three" / "points.csv").unlink()
    write_c3d(tmp_path / "three" / "take.c3d")
    with open(tmp_path / "three" / "campaign.toml", "a", encoding="utf-8") as file:
        file.write('[files.points]\npath = "take.c3d"\nconstants = { body = "base" }\n')
    (tmp_path / "frame").mkdir()
    for name, text in (("campaign.toml", CAMPAIGN), ("targets.csv", TARGETS)):
        (tmp_path / "frame" / name).write_text(text)
    (tmp_path / "raw").mkdir()
    shutil.copy(tmp_path / "one" / "points.csv", tmp_path / "raw")
    (tmp_path / "driver").mkdir()
    (tmp_path / "driver" / "driver.py").write_text(_DRIVER)
    return tmp_path


def _python(words: list[str], cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(PROJECT), "OMP_NUM_THREADS": "1"}
    environment.pop("PYTHONSAFEPATH", None)
    return subprocess.run(
        [sys.executable, *words], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )


def test_no_command_runs_code_that_lies_next_to_the_data(planted: Path, workplace: Path) -> None:
    run = str(shutil.copytree(workplace / "runs" / "telescope", planted / "run"))
    many = ["run", ".", "../two", "--only", "ingest", "--quiet", "--workers", "2"]
    calls = {
        "check": ["check", "."],
        "check of markers": ["check", "../three"],
        "processes": [*many, "--out", "../processes"],
        "Dask": [*many, "--out", "../dask", "--scheduler", "local"],
        "init": ["init", "../raw"],
        "export": ["export", run, "--to", "csv", "--out", "../exports"],
        "compare": ["compare", run, run, "--out", "../comparison"],
        "predict": ["predict", f"{run}/model.toml", "configurations.csv", "--out", "../poses.csv"],
        "plan": ["plan", "../frame", "--stations", "3", "--directions", "8", "--out", "../plan.csv"],
        "stages": ["stages", ".", "--out", "../processes/one"],
    }
    done = _python([str(planted / "driver" / "driver.py"), json.dumps(list(calls.values()))], planted / "one")
    codes, imported = json.loads(done.stdout.splitlines()[-1])
    assert not (planted / "mark").exists(), (planted / "mark").read_text()
    expected = {"check of markers": 2, "compare": 2}  # markers of other names than the survey's; one run twice
    assert dict(zip(calls, codes, strict=True)) == {**dict.fromkeys(calls, 0), **expected}, done.stderr
    assert {"numpy", "pyarrow", "distributed", "multiprocessing"} <= set(imported)
    assert set(imported) - _names() <= {"__main__", "__mp_main__"}, "a name that is imported and was not planted"


@pytest.mark.parametrize("package", ["truing", "pipeline"])
def test_python_m_leaves_the_current_folder_where_the_command_begins(package: str, tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    for name in ("typer", "numpy", "pyarrow"):
        (tmp_path / "one" / f"{name}.py").write_text(f"open({str(tmp_path / 'mark')!r}, 'a').write({name!r})\n")
    assert _python(["-m", package, "check", "."], tmp_path / "one").returncode == 2  # there is no campaign
    assert not (tmp_path / "mark").exists()
    _python(["-c", "import typer"], tmp_path / "one")
    assert (tmp_path / "mark").read_text() == "typer"  # which is run where nothing prevents it


def test_settings_of_numba_next_to_the_data_say_nothing(tmp_path: Path) -> None:
    """They name, among other things, the folder that compiled code is loaded from."""
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: .\ndisable_jit: 1\n")
    reading = "numba.core.config as c; print([c.CACHE_DIR, c.DISABLE_JIT])"
    program = f"import truing.compiled_code, {reading}"
    assert _python(["-c", program], tmp_path).stdout == "['', 0]\n"


@pytest.mark.parametrize("package", PACKAGES)
def test_modules_that_start_processes_use_child_processes(package: str) -> None:
    sources = {path: path.read_text(encoding="utf-8") for path in (PROJECT / package).rglob("*.py")}
    starts = [path for path, text in sources.items() if any(f"import {name}" in text for name in _STARTS_PROCESSES)]
    assert [path for path in starts if "truing.child_processes" not in sources[path]] == []
