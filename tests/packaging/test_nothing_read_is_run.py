"""No input file can make the program run code: nothing is unpickled, evaluated or passed to a shell."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests.packaging.source_tree import PACKAGES, PROJECT, imported_names, module_name, modules, within

MODULES = ("pickle", "cPickle", "cloudpickle", "dill", "joblib", "marshal", "shelve", "yaml", "numpy.load", "pty")
CALLS = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "np.load", "pd.read_pickle", "extractall"}


METHODS = ("extract", "extractall", "read_pickle", "to_pickle")
WORDS = ("allow_pickle", "shell")
_SUSPECT = re.compile("|".join(name.rpartition(".")[2] for name in (*MODULES, *CALLS, *METHODS, *WORDS)))


def _dangerous(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8")
    if not _SUSPECT.search(text):  # most files need no closer look
        return []
    imported = [name for name in imported_names(path) if any(within(name, module) for module in MODULES)]
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    words = [ast.unparse(word) for call in calls for word in call.keywords if word.arg in WORDS]
    called = [name for name in (ast.unparse(call.func) for call in calls) if name in CALLS or _is_method(name)]
    return sorted([*imported, *called, *words])


def _is_method(name: str) -> bool:
    return "." in name and name.rpartition(".")[2] in METHODS


@pytest.mark.parametrize("package", PACKAGES)
def test_files_that_are_read_are_never_executed(package: str) -> None:
    assert {module_name(path): found for path in modules(package) if (found := _dangerous(path))} == {}


@pytest.mark.parametrize(
    "line",
    [
        "import pickle",
        "from yaml import load",
        "np.load(f)",
        "eval(text)",
        "archive.extractall(to)",
        "run(c, shell=True)",
    ],
)
def test_a_dangerous_line_is_found(tmp_path: Path, line: str) -> None:
    (tmp_path / "m.py").write_text(line + "\n")
    assert _dangerous(tmp_path / "m.py") != []


def test_the_whole_project_is_scanned() -> None:
    assert {path.relative_to(PROJECT).parts[0] for package in PACKAGES for path in modules(package)} == set(PACKAGES)
