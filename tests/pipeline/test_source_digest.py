"""Which files a stage consists of: what runs when it runs, and no more."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.remembered import RememberedDigests
from pipeline.source_digest import SourceTree

FILES = {
    "stages/__init__.py": "",
    "stages/pose.py": "from truing.estimation import rigid\n",
    "truing/__init__.py": "import truing.unrelated\n",
    "truing/unrelated.py": "",
    "truing/estimation/__init__.py": "from truing.estimation.face import thing\n",
    "truing/estimation/rigid.py": "",
    "truing/estimation/face.py": "thing = 1\n",
}


def files_of(root: Path, module: str = "stages.pose", **changed: str) -> set[str]:
    for name, text in FILES.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(changed.get(name.replace("/", "_").removesuffix(".py"), text))
    return set(SourceTree(root, RememberedDigests(None)).digests(module))


RIGID = {"stages/pose.py", "truing/estimation/rigid.py"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("from truing.estimation import rigid", RIGID),
        ("import truing.estimation.rigid as r", RIGID),
        ("from truing.estimation.rigid import umeyama", RIGID),
        ("def run():\n    from truing.estimation import rigid", RIGID),
        ("if True:\n    pass\nelse:\n    import truing.estimation.rigid", RIGID),
        ("module = __import__('x')('truing.estimation.rigid')", RIGID),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import truing.estimation.rigid", {"stages/pose.py"}),
        ("'a text that names truing.estimation.rigid in passing'", {"stages/pose.py"}),
        ("import numpy, os.path", {"stages/pose.py"}),
        (
            "from truing.estimation import thing",
            {"stages/pose.py", "truing/estimation/__init__.py", "truing/estimation/face.py"},
        ),
    ],
)
def test_imports_are_followed_where_they_are_executed(tmp_path: Path, text: str, expected: set[str]) -> None:
    assert files_of(tmp_path, stages_pose=text) == expected


def test_relative_imports(tmp_path: Path) -> None:
    expected = {"truing/estimation/rigid.py", "truing/estimation/face.py", "truing/unrelated.py"}
    text = "from .face import thing\nfrom .. import unrelated\n"
    assert files_of(tmp_path, "truing.estimation.rigid", truing_estimation_rigid=text) == expected


def test_data_files_beside_a_module_count(tmp_path: Path) -> None:
    place = tmp_path / "truing" / "estimation" / "templates"
    place.mkdir(parents=True)
    (place / "page.html").write_text("<p>")
    (place / "notes.txt").write_text("nothing that a stage reads")
    assert files_of(tmp_path) == {*RIGID, "truing/estimation/templates/page.html"}


def test_remembered_imports_do_not_outlive_a_change(tmp_path: Path) -> None:
    files_of(tmp_path)
    remembered = RememberedDigests(tmp_path / "digests.json")
    SourceTree(tmp_path, remembered).digests("stages.pose")
    remembered.save()
    (tmp_path / "stages/pose.py").write_text("import truing.unrelated")
    again = SourceTree(tmp_path, RememberedDigests(tmp_path / "digests.json"))
    assert set(again.digests("stages.pose")) == {"stages/pose.py", "truing/unrelated.py"}
