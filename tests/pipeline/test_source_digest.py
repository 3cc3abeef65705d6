"""Source files of a stage: exactly those that it executes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from truing.pipeline.manifest import DigestCache
from truing.pipeline.source_digest import SourceTree

FILES = {
    "stages/__init__.py": "",
    "stages/pose.py": "from truing.estimation import rigid\n",
    "truing/__init__.py": "import truing.unrelated\n",
    "truing/unrelated.py": "",
    "truing/estimation/__init__.py": "from truing.estimation.face import thing\n",
    "truing/estimation/rigid.py": "",
    "truing/estimation/face.py": "thing = 1\n",
}


def files_of(root: Path, module: str = "truing.stages.pose", **changed: str) -> set[str]:
    for name, text in FILES.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(changed.get(name.replace("/", "_").removesuffix(".py"), text))
    return set(SourceTree(root, DigestCache(None)).digests(module))


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


def test_data_files_next_to_a_module_count(tmp_path: Path) -> None:
    place = tmp_path / "truing" / "estimation" / "templates"
    place.mkdir(parents=True)
    (place / "page.html").write_text("<p>")
    (place / "notes.txt").write_text("nothing that a stage reads")
    assert files_of(tmp_path) == {*RIGID, "truing/estimation/templates/page.html"}


def test_remembered_imports_do_not_outlive_a_change(tmp_path: Path) -> None:
    files_of(tmp_path)
    remembered = DigestCache(tmp_path / "digests.json")
    SourceTree(tmp_path, remembered).digests("truing.stages.pose")
    remembered.save()
    (tmp_path / "stages/pose.py").write_text("import truing.unrelated")
    again = SourceTree(tmp_path, DigestCache(tmp_path / "digests.json"))
    assert set(again.digests("truing.stages.pose")) == {"stages/pose.py", "truing/unrelated.py"}


def _aged(root: Path) -> None:
    """Make all files of a project as old as finished ones."""
    for path in root.rglob("*"):
        os.utime(path, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns - 60_000_000_000))


def test_digests_are_cached_until_a_file_changes(tmp_path: Path, monkeypatch) -> None:
    files_of(tmp_path)
    _aged(tmp_path)
    first = SourceTree(tmp_path, DigestCache(None)).digests("truing.stages.pose")
    with monkeypatch.context() as patch:
        patch.setattr(DigestCache, "digest", lambda self, path: pytest.fail(f"{path} was read again"))
        assert SourceTree(tmp_path, DigestCache(None)).digests("truing.stages.pose") == first
        with pytest.raises(pytest.fail.Exception, match="was read again"):
            SourceTree(tmp_path, DigestCache(None, distrust=True)).digests("truing.stages.pose")
    (tmp_path / "truing/estimation/rigid.py").write_text("# another\n")
    _aged(tmp_path)
    assert SourceTree(tmp_path, DigestCache(None)).digests("truing.stages.pose") != first
    assert files_of(tmp_path, stages_pose="from truing.estimation import thing\n") != RIGID


@pytest.mark.parametrize(
    "text",
    [
        "def run():\n# a comment that begins a line\n    from truing.estimation import rigid",
        'words = """\nof several lines\n"""; from truing.estimation import rigid',
        "from \\\ntruing.estimation import rigid",
        "from truing.estimation import (\nrigid\n)",
        "try:\n    import numpy\nexcept ImportError:\n    import truing.estimation.rigid",
        "class A:\n  def run(self):\n    return 'truing.estimation.rigid'",
    ],
)
def test_however_a_source_is_laid_out_its_imports_are_followed(tmp_path: Path, text: str) -> None:
    assert files_of(tmp_path, stages_pose=text) == RIGID


def test_links_that_lead_nowhere_end_nothing(tmp_path: Path) -> None:
    (tmp_path / "truing").mkdir()
    (tmp_path / "truing" / ".#being_edited.py").symlink_to(tmp_path / "nowhere")
    assert files_of(tmp_path) == RIGID
