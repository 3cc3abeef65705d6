"""MATLAB files: variables side by side as columns of one table, numbers and text; no objects are constructed.

scipy reads files up to version 7, HDF5 those of version 7.3.
"""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from truing.formats.compression import FREE, LARGEST_RATIO
from truing.formats.dictionaries import as_dictionary, strings
from truing.formats.raw import Kind, RawBatch, Unusable, Wanted, consecutive
from truing.schemas.faults import first_line
from truing.schemas.mapping import FileMapping
from truing.schemas.memory import raise_shortage

if TYPE_CHECKING:
    import h5py
_HDF5 = b"\x89HDF\r\n\x1a\n"
_HEADER = 128  # bytes before the first element of a file up to version 7
_COMPRESSED = 15  # type of a compressed element, which holds another one
_DEEPEST = 8
_MOST_VARIABLES = 20_000
_FILTERS = {"gzip", "shuffle", "fletcher32", "lzf", "scaleoffset", "szip"}
_AS_TEXT = "writetable(T, 'name.csv') in MATLAB, or table2array(T) for its numbers"
_MOST_ROWS = 1 << 16  # per batch
_WHOLE = 2**53


@dataclass(frozen=True)
class Opaque:
    """A variable of neither numbers nor text: its kind, and the form to save instead."""

    what: str
    cure: str


Numbers = NDArray


Variable = Numbers | list[str] | Opaque


"""Numbers as MATLAB shows them (rows first), a column of texts, or what cannot be read."""


@contextmanager
def open_variables(path: Path) -> Iterator[Mapping[str, Variable]]:
    """Yield the variables of a file by name, fields of structs as ``a.b.c``; raises Unusable for a damaged file."""
    with path.open("rb") as stream:
        head = stream.read(_HEADER)
        stream.seek(512)
        later = stream.read(len(_HDF5))
    if _HDF5 in (head[: len(_HDF5)], later):
        with _open_hdf5(path) as variables:
            yield variables
        return
    yield _read_before_7_3(path)


# -- up to version 7 --------------------------------------------------------------------------------------


def _read_before_7_3(path: Path) -> dict[str, Variable]:
    from scipy.io import loadmat

    content_size = _content(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about duplicate names, such as several unnamed objects
            content = loadmat(path)
    except OSError:
        raise
    except Exception as error:  # scipy passes on any exception that a damaged file causes
        if content_size > FREE:  # below, a lack of memory means a wrong size in the file
            raise_shortage(error)
        raise Unusable("an undamaged MATLAB file (.mat)", value=first_line(error)[:80]) from None
    variables: dict[str, Variable] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            variables.update(_flat(name, value, 0))
    return variables


def _content(path: Path) -> int:
    """Return the number of bytes of a file with its elements decompressed; raises Unusable beyond the allowed ratio."""
    size = path.stat().st_size
    content_size, most = size, max(FREE, LARGEST_RATIO * size)
    with path.open("rb") as stream:
        head = stream.read(_HEADER)
        order = "<" if head[126:128] == b"IM" else ">"
        while len(tag := stream.read(8)) == 8:
            kind, count = struct.unpack(f"{order}II", tag)
            after = stream.tell() + count
            if kind == _COMPRESSED:
                content_size += _unpacked(stream.read(min(count, size)), most - content_size)
                if content_size > most:
                    raise Unusable(f"content of at most {LARGEST_RATIO} times the file's size")
            if after > size:
                break
            stream.seek(after)
    return content_size


def _unpacked(data: bytes, most: int) -> int:
    unpacker, total = zlib.decompressobj(), 0
    try:
        while data and total <= most:
            total += len(unpacker.decompress(data, 1 << 22))
            data = unpacker.unconsumed_tail
    except zlib.error:
        raise Unusable("an undamaged MATLAB file; this one is damaged") from None
    return total


def _flat(name: str, value: object, depth: int) -> Iterator[tuple[str, Variable]]:
    from scipy.io.matlab import MatlabFunction, MatlabOpaque
    from scipy.sparse import issparse

    if issparse(value):
        yield name, Opaque("a sparse matrix", f"full({name})")
    elif isinstance(value, MatlabOpaque | MatlabFunction) or not isinstance(value, np.ndarray):
        yield name, Opaque("a table or another object of MATLAB", _AS_TEXT)
    elif value.dtype.names is not None:
        for field in value.dtype.names if depth < _DEEPEST else ():
            inner = value[field].ravel(order="F")
            yield from _flat(f"{name}.{field}", inner[0] if len(inner) == 1 else _cells(inner), depth + 1)
    elif value.dtype == object:
        yield name, _plain(_cells(value.ravel(order="F")), name)
    else:
        yield name, _plain(value, name)


def _cells(cells: NDArray[np.object_]) -> object:
    """Return cells, or a field of several structs, as a column if each holds one number or one text."""
    if all(isinstance(cell, np.ndarray) and cell.dtype.kind in "biuf" and cell.size == 1 for cell in cells):
        return np.array([float(cell.ravel()[0]) for cell in cells]).reshape(-1, 1)
    if all(isinstance(cell, np.ndarray) and cell.dtype.kind == "U" and cell.size <= 1 for cell in cells):
        return np.array([str(cell.ravel()[0]) if cell.size else "" for cell in cells])
    return np.empty(0, dtype=object)


def _plain(value: Any, name: str) -> Variable:
    kind = value.dtype.kind
    if kind in "biuf":
        return np.asarray(value)
    if kind == "U":
        return [str(text) for text in value.ravel()]
    if kind == "c":
        return Opaque("complex numbers", f"real({name}) and imag({name})")
    return Opaque("cells of mixed content", f"cell2mat({name}), or a matrix of its numbers")


# -- version 7.3 ------------------------------------------------------------------------------------------


@contextmanager
def _open_hdf5(path: Path) -> Iterator[Mapping[str, Variable]]:
    try:
        import h5py
    except ModuleNotFoundError:
        raise Unusable("save('name.mat', '-v7') here: version 7.3 needs h5py, which is not installed") from None
    left = max(FREE, LARGEST_RATIO * path.stat().st_size)
    try:
        with h5py.File(path, "r", locking=False) as file:
            variables_of_file = dict(_variables_of_group(file, "", 0, left))
    except Unusable:
        raise
    except Exception as error:  # h5py passes on any exception that a damaged file causes
        raise_shortage(error)
        raise Unusable("an undamaged MATLAB file (.mat, version 7.3)", value=str(error)[:80]) from None
    yield variables_of_file


def _variables_of_group(group: h5py.Group, above: str, depth: int, most: int) -> Iterator[tuple[str, Variable]]:
    import h5py

    for number, key in enumerate(group):
        if key.startswith("#") or number > _MOST_VARIABLES or depth > _DEEPEST:
            continue
        name = f"{above}{key}"
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            yield name, Opaque("a link to elsewhere", "the variable itself")
            continue
        item = group[key]
        if isinstance(item, h5py.Group):
            if "MATLAB_sparse" in item.attrs:
                yield name, Opaque("a sparse matrix", f"full({name})")
            else:
                yield from _variables_of_group(item, f"{name}.", depth + 1, most)
        elif isinstance(item, h5py.Dataset):
            yield name, _variable_of_dataset(item, name, most)


def _variable_of_dataset(item: h5py.Dataset, name: str, most: int) -> Variable:
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode(errors="replace") if isinstance(kind, bytes) else str(kind)
    if item.is_virtual or item.external or not _FILTERS.issuperset(_filters(item)):
        return Opaque("data that lie elsewhere, or compressed in another way than MATLAB does", "the variable itself")
    if item.size is None or item.size * item.dtype.itemsize > most:
        raise Unusable(f"variables of at most {LARGEST_RATIO} times the file's size", column=name)
    if "MATLAB_object_decode" in item.attrs or item.dtype.kind not in "biufOV" or kind in ("table", "string"):
        return Opaque("a table or another object of MATLAB", _AS_TEXT)
    if item.dtype.kind == "V":
        return Opaque("complex numbers", f"real({name}) and imag({name})")
    if item.dtype.kind == "O":
        return _variable_of_references(item, name, most)
    values = np.asarray(item[()])
    if "MATLAB_empty" in item.attrs:
        return np.empty((0, 0))
    values = values.T if kind else values  # MATLAB stores columns first
    return ["".join(map(chr, row)).strip() for row in np.atleast_2d(values).tolist()] if kind == "char" else values


def _filters(item: h5py.Dataset) -> set[str]:
    return set(item._filters)


def _variable_of_references(item: h5py.Dataset, name: str, most: int) -> Variable:
    """Return the cells of a cell array, or a field of several structs: one number or one text each."""
    import h5py

    targets = [item.file[reference] for reference in np.asarray(item[()]).ravel().tolist()]
    if not all(isinstance(target, h5py.Dataset) and target.dtype.kind != "O" for target in targets):
        return Opaque("cells of mixed content", f"cell2mat({name}), or a matrix of its numbers")
    inner = [_variable_of_dataset(target, name, most) for target in targets]
    if all(isinstance(value, list) and len(value) <= 1 for value in inner):
        return ["".join(value) for value in inner]  # type: ignore[arg-type]
    if all(isinstance(value, np.ndarray) and value.size == 1 for value in inner):
        return np.array([float(value.ravel()[0]) for value in inner]).reshape(-1, 1)  # type: ignore[union-attr]
    return Opaque("cells of mixed content", f"cell2mat({name}), or a matrix of its numbers")


@dataclass(frozen=True)
class Block:
    """A variable as columns: names, with numbers (N, C), or N texts."""

    variable: str
    names: tuple[str, ...]
    values: NDArray | list[str]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.values)


def read_matlab(path: Path, wanted: Wanted, entry: FileMapping) -> Iterator[RawBatch]:
    """Yield the rows of the variables of ``variable``; raises Unusable for missing or incompatible variables."""
    with open_variables(path) as variables:
        blocks = blocks_of(variables, entry)
    names = tuple(name for block in blocks for name in block.names)
    names = (*entry.names[: len(names)], *names[len(entry.names) :])
    kinds = wanted(names, None)
    if kinds is None:
        return
    rows = blocks[0].rows
    cells = [(block, column) for block in blocks for column in range(len(block.names))]
    for start in range(0, rows, _MOST_ROWS):
        count = min(_MOST_ROWS, rows - start)
        columns = {at: _column(*cells[at], slice(start, start + count), kind) for at, kind in kinds.items()}
        yield RawBatch(columns, consecutive(start, count))


def blocks_of(variables: Mapping[str, Variable], entry: FileMapping) -> list[Block]:
    """Return the variables that a mapping names, or the only numeric one, in blocks of equal numbers of rows."""
    named = (entry.variable,) if isinstance(entry.variable, str) else entry.variable or _only_one(variables)
    alone = len(named) == 1
    blocks = [_block(name, _variable(variables, name), alone, entry.transpose) for name in named]
    lengths = {block.rows for block in blocks}
    if len(lengths) > 1:
        sizes = ", ".join(f"{block.variable} {block.rows}" for block in blocks)
        hint = "" if entry.transpose else "; transpose = true where rows of the file are columns of the table"
        raise Unusable(f"variables with equally many rows{hint}", column="variable", value=sizes)
    if not blocks[0].rows:
        raise Unusable("at least one row", column="variable", value=", ".join(named))
    return blocks


def _variable(variables: Mapping[str, Variable], name: str) -> Variable:
    value = variables.get(name)
    if value is None:
        within = [variable for variable in variables if variable.startswith(f"{name}.")]
        raise Unusable(f"a variable of the file: {_listed(within or list(variables))}", column="variable", value=name)
    if isinstance(value, Opaque):
        raise Unusable(f"numbers or text; save {value.cure}", column="variable", value=f"{name}: {value.what}")
    return value


def _only_one(variables: Mapping[str, Variable]) -> tuple[str, ...]:
    numbers = [name for name, value in variables.items() if isinstance(value, np.ndarray) and value.size > 1]
    if len(numbers) != 1:
        texts = [f"{name} {shape_of(value)}" for name, value in variables.items()]
        example = f"variable = {list(numbers[:2])}" if numbers else "numbers"
        raise Unusable(f"which variables to read: {example}", column="variable", value=_listed(texts))
    return (numbers[0],)


def shape_of(value: Variable) -> str:
    """Return the size of a variable in words."""
    if isinstance(value, Opaque):
        return f"({value.what})"
    if isinstance(value, list):
        return f"({len(value)} texts)"
    return "x".join(map(str, value.shape))


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")


def _block(name: str, value: Variable, alone: bool, transpose: bool) -> Block:
    """Return a variable as columns: one per vector; a stack of matrices (r x c x N) as N rows with m00, m01, ...
    each, and a transposed one (N x r x c) likewise."""
    short = name.rsplit(".", 1)[-1]
    if isinstance(value, list):
        return Block(name, (short,), value)
    if not isinstance(value, np.ndarray) or value.ndim > 3:
        raise Unusable("at most three dimensions", column="variable", value=f"{name} {shape_of(value)}")
    if value.ndim == 3:
        stack = value if transpose else np.moveaxis(value, 2, 0)
        count, rows, columns = stack.shape
        prefix = "" if alone else f"{short}_"
        names = tuple(f"{prefix}m{i}{j}" for i in range(rows) for j in range(columns))
        return Block(name, names, stack.reshape(count, rows * columns))
    matrix = np.atleast_2d(value)
    if 1 in matrix.shape:
        return Block(name, (short,), matrix.reshape(-1, 1))
    matrix = matrix.T if transpose else matrix
    width = matrix.shape[1]
    names = tuple(str(column + 1) for column in range(width))
    return Block(name, names if alone else tuple(f"{short}_{number}" for number in names), matrix)


def _column(block: Block, column: int, rows: slice, kind: Kind) -> pa.Array:
    if isinstance(block.values, list):
        texts = strings(block.values[rows])
        return texts if kind in ("number", "seconds") else as_dictionary(texts)
    values = np.ascontiguousarray(block.values[rows, column])
    if kind in ("number", "seconds"):
        return pa.array(values.astype(np.float64))
    plain = values.astype(np.float64)
    is_whole = bool(np.all(np.isfinite(plain)) and np.all(plain == np.round(plain)) and np.all(np.abs(plain) < _WHOLE))
    if is_whole:
        numbers = pa.array(plain.astype(np.int64))
        return numbers if kind == "identifier" else as_dictionary(numbers)
    return as_dictionary(strings([repr(value) for value in plain.tolist()]))
