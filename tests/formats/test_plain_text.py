"""The compiled parser of plain text agrees with the general one bit for bit, or leaves the block to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.formats.reading import read
from truing.formats import delimited
from truing.formats.delimited import _Parser
from truing.formats.plain_text import plain_columns
from truing.formats.text import Lines
from truing.schemas.mapping import FileMapping

_KINDS = {0: "identifier", 1: "text", 2: "number", 4: "text"}
_DIGITS = st.text("0123456789", min_size=1, max_size=20)
_SIGNS = st.sampled_from(["", "-", "+"])
_NUMBERS = st.one_of(
    st.floats(allow_nan=False).map(repr),
    st.builds("{}{}.{}".format, _SIGNS, _DIGITS, _DIGITS),
    st.builds("{}{}".format, _SIGNS, _DIGITS),
    st.sampled_from(["-0.0", "0", ".5", "5.", "", " 1.5", "1e-7", "nan", "inf", "9007199254740993", "1,5", "0x1f"]),
)
_NAMES = st.one_of(st.sampled_from(["B01", "B02", "B1", "", " B01"]), st.text("aä\t;-é°", max_size=3))
_ROWS = st.lists(st.tuples(_NUMBERS, _NAMES, _NUMBERS, _NAMES, _NAMES).map(list), min_size=1, max_size=5)


def parsed(text: bytes, is_compiled: bool) -> tuple:
    entry = FileMapping.model_validate({"path": "points.csv"})
    parser = _Parser(Lines.of(entry, ";"), ";", entry, 5, _KINDS, is_compiled)  # type: ignore[arg-type]
    batch, count = parser.parse(text)
    columns = {
        key: values.to_pylist() if values.type != "double" else values.to_numpy(zero_copy_only=False).tobytes()
        for key, values in batch.columns.items()
    }
    return columns, {key: values.type for key, values in batch.columns.items()}, batch.records.tolist(), count


@given(_ROWS, st.sampled_from(["\n", "\r\n"]), st.booleans())
@example([["1", "B01", "0.1", "", "x"], ["2", "B02", "-0.0", "", "x"]], "\n", True)
@example([["1", "B01", "0.1", "", "x"], ["2", "B02"]], "\n", True)
def test_every_block_reads_the_same_compiled_or_not(rows: list[list[str]], end: str, ends: bool) -> None:
    text = (end.join(";".join(row) for row in rows) + (end if ends else "")).encode()
    assert parsed(text, True) == parsed(text, False)


@given(st.lists(st.tuples(_SIGNS.filter(lambda sign: sign != "+"), st.integers(0, 2**53), st.integers(0, 15))))
def test_every_plain_number_is_the_nearest_float(parts: list[tuple[str, int, int]]) -> None:
    cells = []
    for sign, whole, decimals in parts:
        digits = str(whole).rjust(decimals + 1, "0")[-18:]
        cells.append(f"{sign}{digits[: len(digits) - decimals]}.{digits[len(digits) - decimals :]}".rstrip("."))
    text = "".join(f"{cell}\n" for cell in cells).encode()
    columns = plain_columns(text, ";", ".", {0: "number"}, 1) if cells else None
    if columns is not None:
        assert np.asarray(columns[0][0]).tobytes() == np.array([float(cell) for cell in cells]).tobytes()
    assert columns is not None or not cells


def test_names_are_numbered_by_first_occurrence_and_many_are_left_to_the_general_parser() -> None:
    names = [f"T{number % 700}" for number in range(1500)]
    columns = plain_columns("".join(f"{name}\n" for name in names).encode(), ",", ".", {0: "text"}, 1)
    assert columns is not None
    assert columns[0][0].to_pylist() == names
    assert columns[0][0].dictionary.to_pylist() == list(dict.fromkeys(names))
    every = "".join(f"{number}\n" for number in range(3000)).encode()
    assert plain_columns(every, ",", ".", {0: "text"}, 1) is None


def test_a_large_file_is_read_the_same_and_a_fault_keeps_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [f"{pose},base,B{target},{pose}.25,-0.5,{target}" for pose in range(1, 40) for target in range(5)]
    rows[100] = rows[100].replace("-0.5", "half")
    (tmp_path / "points.csv").write_text("pose,body,target,x_mm,y_mm,z_mm\n" + "\n".join(rows) + "\n")
    readings = []
    for size in (1 << 40, 0):
        monkeypatch.setattr(delimited, "COMPILED_FROM", size)
        readings.append(read(tmp_path))
    assert readings[0] == readings[1]
    assert [fault.row for fault in readings[1].faults] == [102]
