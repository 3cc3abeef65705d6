"""MATLAB files of both versions: equal variables give equal tables, and other content is a fault with a remedy."""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csr_matrix

from tests.formats.reading import read
from tests.sentences import assert_says
from tests.tolerance import assert_close

h5py = pytest.importorskip("h5py", reason="not installed")

RNG = np.random.default_rng(7)
XYZ = RNG.uniform(-100.0, 100.0, (5, 3))
AXES = {f"{a}_mm": column for column, a in enumerate("xyz", start=1)}
POINTS = {"path": "data.mat", "constants": {"body": "b"}, "number_rows": {"pose": 1, "target": 1}}


def older(folder, variables):
    savemat(folder / "data.mat", variables, do_compression=True)


def newer(folder, variables):
    """As MATLAB writes version 7.3: columns first, structs as groups, text as numbers."""

    def put(group, name, value):
        if isinstance(value, dict):
            inner = group.create_group(name)
            inner.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, one in value.items():
                put(inner, key, one)
        else:
            made = group.create_dataset(name, data=np.asarray(value, dtype=float).T)
            made.attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(folder / "data.mat", "w", userblock_size=512) as file:
        for name, value in variables.items():
            put(file, name, value)


WRITERS = pytest.mark.parametrize("write", [older, newer], ids=["v5", "v7.3"])


@WRITERS
def test_a_matrix_gives_columns_by_position(tmp_path, write):
    write(tmp_path, {"xyz": XYZ, "note": np.zeros((1, 1))})
    found = read(tmp_path, entries={**POINTS, "columns": AXES})
    assert found.faults == ()
    assert_close([found.columns[name] for name in AXES], XYZ.T, atol=0.0)


@WRITERS
def test_fields_of_a_struct_are_side_by_side(tmp_path, write):
    write(tmp_path, {"st": {"t": np.arange(5.0).reshape(1, 5), "cable": XYZ.T, "deep": {"er": XYZ.T}}})
    entry = {"path": "data.mat", "variable": ["st.t", "st.cable"], "transpose": True, "number_rows": {"pose": 1}}
    found = read(tmp_path, "configurations", {**entry, "columns": {"time_s": "t", "first": "cable_1"}})
    assert found.faults == ()
    assert found.columns["time_s"] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert_close([found.columns[name] for name in ("first", "cable_2", "cable_3")], XYZ.T, atol=0.0)
    deep = read(tmp_path, entries={**POINTS, "variable": "st.deep.er", "transpose": True, "columns": AXES})
    assert_close([deep.columns[name] for name in AXES], XYZ.T, atol=0.0)


@WRITERS
def test_several_variables_have_to_be_named(tmp_path, write):
    write(tmp_path, {"a": XYZ, "b": XYZ[:4]})
    (fault,) = read(tmp_path, entries={**POINTS, "columns": AXES}).faults
    assert (fault.column, fault.value) == ("variable", "a 5x3, b 4x3")
    (fault,) = read(tmp_path, entries={**POINTS, "variable": ["a", "b"], "columns": AXES}).faults
    assert (fault.column, fault.value) == ("variable", "a 5, b 4")
    (fault,) = read(tmp_path, entries={**POINTS, "variable": "c", "columns": AXES}).faults
    assert (fault.column, fault.value) == ("variable", "c")


@WRITERS
def test_faults_count_rows_of_the_matrix(tmp_path, write):
    wrong = XYZ.copy()
    wrong[3, 1] = np.nan
    write(tmp_path, {"xyz": wrong})
    (fault,) = read(tmp_path, entries={**POINTS, "columns": AXES}).faults
    assert (fault.row, fault.column) == (4, "2")


def test_a_matlab_variable_without_numbers_names_the_cure(tmp_path):
    older(tmp_path, {"s": csr_matrix(np.eye(3)), "c": np.array([1.0 + 2.0j, 3.0])})
    for name, cure in (("s", "full(s)"), ("c", "real(c)")):
        (fault,) = read(tmp_path, entries={**POINTS, "variable": name, "columns": AXES}).faults
        assert cure in fault.expected


def test_cells_of_text_are_names(tmp_path):
    older(tmp_path, {"xyz": XYZ, "names": np.array(["T1", "T2", "T3", "T4", "T5"], dtype=object).reshape(-1, 1)})
    entry = {"path": "data.mat", "constants": {"body": "b", "pose": 1}, "variable": ["names", "xyz"]}
    columns = {"target": "names", **{name: f"xyz_{number}" for name, number in AXES.items()}}
    found = read(tmp_path, entries={**entry, "columns": columns})
    assert found.faults == ()
    assert found.columns["target"] == ["T1", "T2", "T3", "T4", "T5"]


def test_a_file_of_another_kind_is_no_matlab_file(tmp_path):
    (tmp_path / "data.mat").write_bytes(b"pose,x\n" * 40)
    (fault,) = read(tmp_path, entries=POINTS).faults
    assert "MATLAB file" in fault.expected


@pytest.mark.parametrize("write", [older, newer], ids=["v5", "v7.3"])
def test_a_damaged_file_is_faults_and_no_defect(tmp_path, write):
    write(tmp_path, {"xyz": XYZ, "st": {"t": XYZ}})
    good = (tmp_path / "data.mat").read_bytes()
    rng = np.random.default_rng(11)
    for _ in range(60):
        data = bytearray(good)
        for place in rng.integers(0, len(data), 4):
            data[place] = int(rng.integers(256))
        (tmp_path / "data.mat").write_bytes(bytes(data[: int(rng.integers(len(data) // 2, len(data) + 1))]))
        read(tmp_path, entries={**POINTS, "variable": "xyz", "columns": AXES})  # raises nothing


def test_a_matlab_file_that_claims_more_than_its_size_is_refused(tmp_path):
    with h5py.File(tmp_path / "data.mat", "w") as file:
        file.create_dataset("xyz", (10**9, 3), chunks=(1000, 3), dtype="f8")
    (fault,) = read(tmp_path, entries={**POINTS, "columns": AXES}).faults
    assert_says(fault.expected, "times", "file's size")


def test_a_length_that_no_memory_holds_is_damage_and_no_want_of_memory(tmp_path, monkeypatch):
    def claims(*_, **__):
        raise MemoryError

    older(tmp_path, {"xyz": XYZ})
    monkeypatch.setattr("scipy.io.loadmat", claims)
    (fault,) = read(tmp_path, entries={**POINTS, "columns": AXES}).faults
    assert "undamaged MATLAB file" in fault.expected


def test_an_element_that_unpacks_without_end_is_refused(tmp_path):
    older(tmp_path, {"xyz": XYZ})
    head = (tmp_path / "data.mat").read_bytes()[:128]
    packed = zlib.compress(bytes(200 << 20), 9)
    (tmp_path / "data.mat").write_bytes(head + np.array([15, len(packed)], "<u4").tobytes() + packed)
    (fault,) = read(tmp_path, entries={**POINTS, "columns": AXES}).faults
    assert_says(fault.expected, "times", "file's size")


def test_a_link_to_another_file_is_not_followed(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = XYZ
    with h5py.File(tmp_path / "data.mat", "w") as file:
        file["xyz"] = h5py.ExternalLink("other.h5", "/secret")
    (fault,) = read(tmp_path, entries={**POINTS, "variable": "xyz", "columns": AXES}).faults
    assert fault.value == "xyz: a link to elsewhere"


def test_names_of_all_numbers_of_a_pose_cut_a_vector(tmp_path):
    older(tmp_path, {"all": XYZ.reshape(-1, 1)})
    entry = {"path": "data.mat", "rows_per_pose": 3, "constants": {"body": "b"}}
    found = read(tmp_path, "poses", {**entry, "names": list(AXES)})
    assert found.faults == ()
    assert_close([found.columns[name] for name in AXES], XYZ.T, atol=0.0)


def test_a_matrix_has_no_first_line_to_speak_of(tmp_path):
    older(tmp_path, {"xyz": XYZ})
    (fault, *_) = read(tmp_path, entries=POINTS).faults
    assert_says(fault.expected, "3 columns", "no names", "by position")
