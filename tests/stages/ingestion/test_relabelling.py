"""Targets under other names: [[renamed]] is applied and counted, contradictions are faults with the names."""

from __future__ import annotations

import re
from collections import Counter

import pytest

from tests.stages.test_ingest import Folder, plain
from truing.schemas.artifacts import ARTIFACTS


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


def called(folder, *names, poses=(2, 3), body="platform"):
    """The campaign whose files call targets otherwise in some poses: (name, in the files)."""
    table = dict(names)
    rows = []
    for row in folder.points[1:]:
        pose, of, target, *rest = row.split(",")
        if of == body and int(pose) in poses:
            target = table.get(target, target)
        rows.append(",".join([pose, of, target, *rest]))
    folder.points = [folder.points[0], *rows]
    return folder


def renamed(**keys):
    given = {"body": "platform", **keys}
    lines = [f"{key} = {value if isinstance(value, int) else repr(value)}" for key, value in given.items()]
    return "\n".join(["\n[[renamed]]", *lines, ""])


def targets(tables):
    observations = plain(tables["observations"])
    return list(zip(*(observations.column(name).to_pylist() for name in ("pose", "body", "target")), strict=True))


def test_targets_under_other_names_are_themselves_again(folder):
    wanted = targets(folder.run()[1])
    called(folder, ("P1", "T112"), ("P2", "P3"), ("P3", "P2"))  # two have taken each other's names
    folder.toml += renamed(target="P1", called="T112", from_pose=2, by="Ann", reason="new project")
    folder.toml += renamed(target="P2", called="P3", from_pose=2) + renamed(
        target="P3", called="P2", from_pose=2, to_pose=3
    )
    _, tables = folder.run()
    assert Counter(targets(tables)) == Counter(wanted)
    reported = tables["relabelled"]
    assert not ARTIFACTS["relabelled"].faults(reported)
    assert reported.column("rows").to_pylist() == [2, 2, 2]
    assert reported.column("reason").to_pylist() == ["Ann: new project", None, None]
    assert reported.column("from_pose").to_pylist() == ["2"] * 3


def test_poses_count_in_the_order_of_time(folder):
    head, *rows = folder.configurations
    times = {"1": "60.0", "2": "180.0", "3": "120.0"}  # pose 3 was taken before pose 2
    folder.configurations = [head, *(r.replace(f",{60.0 * int(r[0])},", f",{times[r[0]]},") for r in rows)]
    called(folder, ("P1", "T112"), poses=(2,))
    folder.toml += renamed(target="P1", called="T112", from_pose=2)
    assert folder.run()[1]["relabelled"].column("rows").to_pylist() == [1]
    folder.toml += renamed(target="P2", called="T9", from_pose=2, to_pose=3)
    assert any(fault.expected.startswith("a pose taken no later than to_pose (3)") for fault in folder.faults())


def test_no_table_of_names_where_nothing_is_called_otherwise(folder):
    assert "relabelled" not in folder.run()[1]


@pytest.mark.parametrize(
    ("entries", "stated"),
    [
        ([{"target": "P1", "called": "T113"}], "1.called: found 'T113'; .* under this name in these poses; .* T112"),
        (
            [{"target": "P9", "called": "T112"}],
            "1.target: found 'P9'; expected a target of body platform in the survey",
        ),
        ([{"target": "P1", "called": "T112", "from_pose": 7}], "renamed.1.from_pose: found '7'; expected a pose of"),
        (
            [{"target": "P1", "called": "T112"}, {"target": "P2", "called": "T112"}],
            "one target for T112 of body platform in one pose; renamed.1 says P1",
        ),
        (
            [{"target": "P1", "called": "T112"}, {"target": "P1", "called": "P2"}],
            "one name for P1 of body platform in one pose; renamed.1 says T112",
        ),
        (
            [{"target": "P2", "called": "T112"}],
            "each pose, body and target once; T112 is P2 there, as renamed.1 has it",
        ),
        ([{"target": "P1", "called": "P1"}], "renamed.1.called: found 'P1'; expected another name than the target"),
    ],
)
def test_contradictory_renames_are_a_fault_with_the_names(folder, entries, stated):
    called(folder, ("P1", "T112"))
    folder.toml += "".join(renamed(**entry) for entry in entries)
    said = [str(fault) for fault in folder.faults()]
    assert any(re.search(stated, one) for one in said), said
