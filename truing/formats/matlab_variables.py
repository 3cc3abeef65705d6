"""Variables of MATLAB files, up to version 7 by scipy and 7.3 by HDF5: numbers and text; objects are never built."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from truing.formats.compression import FREE, LARGEST_RATIO
from truing.formats.raw import Unusable
from truing.schemas.memory import raise_shortage

if TYPE_CHECKING:
    import h5py

_HDF5 = b"\x89HDF\r\n\x1a\n"
_HEADER = 128  # bytes before the first element of a file up to version 7
_COMPRESSED = 15  # type of an element that holds another one, compressed
_DEEPEST = 8
_MOST_VARIABLES = 20_000
_FILTERS = {"gzip", "shuffle", "fletcher32", "lzf", "scaleoffset", "szip"}
_AS_TEXT = "writetable(T, 'name.csv') in MATLAB, or table2array(T) for its numbers"


@dataclass(frozen=True)
class Opaque:
    """A variable that holds neither numbers nor text: what it is, and what to save in its place."""

    what: str
    cure: str


Numbers = NDArray[Any]
Variable = Numbers | list[str] | Opaque
"""Numbers as MATLAB shows them (rows first), a column of texts, or what cannot be read."""


@contextmanager
def open_variables(path: Path) -> Iterator[Mapping[str, Variable]]:
    """The variables of a file by name, fields of structs as ``a.b.c``; raises Unusable where it is no whole file."""
    with path.open("rb") as stream:
        head = stream.read(_HEADER)
        stream.seek(512)
        later = stream.read(len(_HDF5))
    if _HDF5 in (head[: len(_HDF5)], later):
        with _open_hdf5(path) as found:
            yield found
        return
    yield _older(path)


# -- up to version 7 --------------------------------------------------------------------------------------


def _older(path: Path) -> dict[str, Variable]:
    from scipy.io import loadmat

    held = _content(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of names given twice, as several objects have none
            content = loadmat(path)
    except OSError:
        raise
    except Exception as error:  # the library lets whatever a damaged file causes through
        if held > FREE:  # of less, memory is short where a number in the file claims more than it holds
            raise_shortage(error)
        raise Unusable("a whole MATLAB file (.mat)", value=(str(error).splitlines() or [""])[0][:80]) from None
    found: dict[str, Variable] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            found.update(_flat(name, value, 0))
    return found


def _content(path: Path) -> int:
    """The bytes that a file and its compressed elements hold; raises Unusable where they are out of all proportion."""
    size = path.stat().st_size
    held, most = size, max(FREE, LARGEST_RATIO * size)
    with path.open("rb") as stream:
        head = stream.read(_HEADER)
        order = "<" if head[126:128] == b"IM" else ">"
        while len(tag := stream.read(8)) == 8:
            kind, count = struct.unpack(f"{order}II", tag)
            after = stream.tell() + count
            if kind == _COMPRESSED:
                held += _unpacked(stream.read(min(count, size)), most - held)
                if held > most:
                    raise Unusable(f"content of at most {LARGEST_RATIO} times the file's size")
            if after > size:
                break
            stream.seek(after)
    return held


def _unpacked(data: bytes, most: int) -> int:
    unpacker, total = zlib.decompressobj(), 0
    try:
        while data and total <= most:
            total += len(unpacker.decompress(data, 1 << 22))
            data = unpacker.unconsumed_tail
    except zlib.error:
        raise Unusable("a whole MATLAB file; this one is damaged") from None
    return total


def _flat(name: str, value: Any, depth: int) -> Iterator[tuple[str, Variable]]:
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


def _cells(cells: NDArray[np.object_]) -> Any:
    """Cells, or a field of several structs, as a column where each holds one number or one text."""
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
            found = dict(_of_group(file, "", 0, left))
    except Unusable:
        raise
    except Exception as error:  # the library lets whatever a damaged file causes through
        raise_shortage(error)
        raise Unusable("a whole MATLAB file (.mat, version 7.3)", value=str(error)[:80]) from None
    yield found


def _of_group(group: h5py.Group, above: str, depth: int, most: int) -> Iterator[tuple[str, Variable]]:
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
                yield from _of_group(item, f"{name}.", depth + 1, most)
        elif isinstance(item, h5py.Dataset):
            yield name, _of_dataset(item, name, most)


def _of_dataset(item: h5py.Dataset, name: str, most: int) -> Variable:
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
        return _of_references(item, name, most)
    values = np.asarray(item[()])
    if "MATLAB_empty" in item.attrs:
        return np.empty((0, 0))
    values = values.T if kind else values  # columns first, as MATLAB keeps them
    return ["".join(map(chr, row)).strip() for row in np.atleast_2d(values).tolist()] if kind == "char" else values


def _filters(item: h5py.Dataset) -> set[str]:
    return set(item._filters)


def _of_references(item: h5py.Dataset, name: str, most: int) -> Variable:
    """The cells of a cell array, or a field of several structs: one number or one text each."""
    import h5py

    others = [item.file[reference] for reference in np.asarray(item[()]).ravel().tolist()]
    if not all(isinstance(other, h5py.Dataset) and other.dtype.kind != "O" for other in others):
        return Opaque("cells of mixed content", f"cell2mat({name}), or a matrix of its numbers")
    inner = [_of_dataset(other, name, most) for other in others]
    if all(isinstance(value, list) and len(value) <= 1 for value in inner):
        return ["".join(value) for value in inner]  # type: ignore[arg-type]
    if all(isinstance(value, np.ndarray) and value.size == 1 for value in inner):
        return np.array([float(value.ravel()[0]) for value in inner]).reshape(-1, 1)  # type: ignore[union-attr]
    return Opaque("cells of mixed content", f"cell2mat({name}), or a matrix of its numbers")
