"""Variables of a MATLAB file side by side as the columns of one table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truing.formats.dictionaries import as_dictionary, strings
from truing.formats.matlab_variables import Opaque, Variable, open_variables
from truing.formats.raw import Kind, RawBatch, Unusable, Wanted, consecutive
from truing.schemas.mapping import FileMapping

if TYPE_CHECKING:
    import pyarrow as pa

_MOST_ROWS = 1 << 16  # of a batch
_WHOLE = 2**53


@dataclass(frozen=True)
class Block:
    """A variable as columns: names, and numbers (N, C), or N texts."""

    variable: str
    names: tuple[str, ...]
    values: NDArray | list[str]

    @property
    def rows(self) -> int:
        """How many rows."""
        return len(self.values)


def read_matlab(path: Path, wanted: Wanted, entry: FileMapping) -> Iterator[RawBatch]:
    """The rows that ``variable`` makes; raises Unusable where the file holds no such variables, or they do not fit."""
    with open_variables(path) as variables:
        blocks = blocks_of(variables, entry)
    names = tuple(name for block in blocks for name in block.names)
    names = (*entry.names[: len(names)], *names[len(entry.names) :])
    kinds = wanted(names, None)
    if kinds is None:
        return
    rows = blocks[0].rows
    places = [(block, column) for block in blocks for column in range(len(block.names))]
    for start in range(0, rows, _MOST_ROWS):
        count = min(_MOST_ROWS, rows - start)
        columns = {at: _column(*places[at], slice(start, start + count), kind) for at, kind in kinds.items()}
        yield RawBatch(columns, consecutive(start, count))


def blocks_of(variables: Mapping[str, Variable], entry: FileMapping) -> list[Block]:
    """The variables that a mapping names, in blocks of equally many rows; absent, the only one of numbers."""
    named = (entry.variable,) if isinstance(entry.variable, str) else entry.variable or _only_one(variables)
    alone = len(named) == 1
    blocks = [_block(name, _found(variables, name), alone, entry.transpose) for name in named]
    lengths = {block.rows for block in blocks}
    if len(lengths) > 1:
        sizes = ", ".join(f"{block.variable} {block.rows}" for block in blocks)
        way = "" if entry.transpose else "; transpose = true where rows of the file are columns of the table"
        raise Unusable(f"variables with equally many rows{way}", column="variable", value=sizes)
    if not blocks[0].rows:
        raise Unusable("at least one row", column="variable", value=", ".join(named))
    return blocks


def _found(variables: Mapping[str, Variable], name: str) -> Variable:
    value = variables.get(name)
    if value is None:
        within = [other for other in variables if other.startswith(f"{name}.")]
        raise Unusable(f"a variable of the file: {_listed(within or list(variables))}", column="variable", value=name)
    if isinstance(value, Opaque):
        raise Unusable(f"numbers or text; save {value.cure}", column="variable", value=f"{name}: {value.what}")
    return value


def _only_one(variables: Mapping[str, Variable]) -> tuple[str, ...]:
    numbers = [name for name, value in variables.items() if isinstance(value, np.ndarray) and value.size > 1]
    if len(numbers) != 1:
        told = [f"{name} {shape_of(value)}" for name, value in variables.items()]
        example = f"variable = {list(numbers[:2])}" if numbers else "numbers"
        raise Unusable(f"which variables to read: {example}", column="variable", value=_listed(told))
    return (numbers[0],)


def shape_of(value: Variable) -> str:
    """The size of a variable in words."""
    if isinstance(value, Opaque):
        return f"({value.what})"
    if isinstance(value, list):
        return f"({len(value)} texts)"
    return "x".join(map(str, value.shape))


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")


def _block(name: str, value: Variable, alone: bool, transpose: bool) -> Block:
    """A variable as columns: vectors as one; a stack of matrices (r x c x N) as N rows with m00, m01, ... each."""
    short = name.rsplit(".", 1)[-1]
    if isinstance(value, list):
        return Block(name, (short,), value)
    if not isinstance(value, np.ndarray) or value.ndim > 3:
        raise Unusable("at most three dimensions", column="variable", value=f"{name} {shape_of(value)}")
    if value.ndim == 3:
        rows, columns, count = value.shape
        prefix = "" if alone else f"{short}_"
        names = tuple(f"{prefix}m{i}{j}" for i in range(rows) for j in range(columns))
        return Block(name, names, np.moveaxis(value, 2, 0).reshape(count, rows * columns))
    matrix = np.atleast_2d(value)
    if 1 in matrix.shape:
        return Block(name, (short,), matrix.reshape(-1, 1))
    matrix = matrix.T if transpose else matrix
    width = matrix.shape[1]
    names = tuple(str(column + 1) for column in range(width))
    return Block(name, names if alone else tuple(f"{short}_{number}" for number in names), matrix)


def _column(block: Block, column: int, rows: slice, kind: Kind) -> pa.Array:
    import pyarrow as pa

    if isinstance(block.values, list):
        texts = strings(block.values[rows])
        return texts if kind in ("number", "seconds") else as_dictionary(texts)
    values = np.ascontiguousarray(block.values[rows, column])
    if kind in ("number", "seconds"):
        return pa.array(values.astype(np.float64))
    plain = values.astype(np.float64)
    whole = bool(np.all(np.isfinite(plain)) and np.all(plain == np.round(plain)) and np.all(np.abs(plain) < _WHOLE))
    if whole:
        numbers = pa.array(plain.astype(np.int64))
        return numbers if kind == "identifier" else as_dictionary(numbers)
    return as_dictionary(strings([repr(value) for value in plain.tolist()]))
