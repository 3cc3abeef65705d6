"""Stub shared libraries in memory, for a headless Linux machine without the real ones.

A library such as Open3D links the system's graphics libraries, although reading a point cloud never calls them. The
system's loader needs them nevertheless, and installing them takes an administrator. A stub has the name and the
requested functions; each returns 0, which means "there is none" for EGL, GLX and Xlib. Layout: System V ABI, "Object
Files" and "Dynamic Linking", with its x86-64 supplement.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import re
from itertools import accumulate
from pathlib import Path
from struct import Struct, pack

_ELF_HEADER, _PROGRAM_HEADER = Struct("<16sHHIQQQIHHHHHH"), Struct("<IIQQQQQQ")
_SECTION_HEADER, _SYMBOL = Struct("<IIQQQQIIQQ"), Struct("<IBBHQQ")
_SHARED_OBJECT, _X86_64 = 3, 62
_LOADED, _DYNAMIC, _STACK = 1, 2, 0x6474E551  # kinds of program headers
_RUN, _WRITE, _READ = 1, 2, 4
_HASH, _STRINGS, _SYMBOLS, _STRINGS_SIZE, _SYMBOL_SIZE, _SONAME = 4, 5, 6, 10, 11, 14  # dynamic tags
_DYNAMIC_SYMBOLS = 11  # kind of a section
_GLOBAL_FUNCTION = 0x12
_PAGE = 0x1000
_RETURN_ZERO = b"\x31\xc0\xc3"  # xor eax, eax; ret


def provide_stub_library(soname: str, functions: list[str]) -> None:
    """Make the library `soname`, with these functions, resolvable for every library loaded after it."""
    descriptor = os.memfd_create(soname)
    os.write(descriptor, shared_library(soname, functions))
    # The descriptor stays open: the loader takes an equal path for the same library, so none may be used twice.
    ctypes.CDLL(f"/proc/self/fd/{descriptor}", mode=ctypes.RTLD_GLOBAL)


def missing_functions(library: Path, pattern: str) -> list[str]:
    """Return names matching `pattern` that a 64-bit ELF library expects other libraries to define."""
    with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as image:
        symbols, strings = _dynamic_symbols(image)
    undefined = [name for name, _, _, section, _, _ in _SYMBOL.iter_unpack(symbols) if name and not section]
    names = (strings[start : strings.index(b"\0", start)].decode() for start in undefined)
    return sorted(name for name in names if re.fullmatch(pattern, name))


def _dynamic_symbols(image: mmap.mmap) -> tuple[bytes, bytes]:
    """Return the dynamic symbol table and its strings."""
    header = _ELF_HEADER.unpack_from(image)
    start, size, count = header[6], header[11], header[12]
    sections = [_SECTION_HEADER.unpack_from(image, start + i * size) for i in range(count)]
    table = next(section for section in sections if section[1] == _DYNAMIC_SYMBOLS)
    symbols, strings = (image[at : at + size] for _, _, _, _, at, size, *_ in (table, sections[table[6]]))
    return symbols, strings


def shared_library(soname: str, functions: list[str]) -> bytes:
    """Return the bytes of an ELF shared library for x86-64 whose functions all return 0."""
    names = [b"", *(name.encode() for name in (*functions, soname))]
    strings = b"\0".join(names) + b"\0"
    *offsets, soname_offset = list(accumulate((len(name) + 1 for name in names), initial=0))[:-1]

    chain = _hash_table(len(offsets))
    hash_at = _ELF_HEADER.size + 4 * _PROGRAM_HEADER.size
    symbols_at = hash_at + len(chain)
    strings_at = symbols_at + len(offsets) * _SYMBOL.size
    code_at = strings_at + len(strings)
    end = code_at + len(_RETURN_ZERO)
    dynamic_at = -(-end // _PAGE) * _PAGE  # on a page of its own, because some loaders write into it

    symbol = [(offset, _GLOBAL_FUNCTION, 0, 1, code_at, len(_RETURN_ZERO)) for offset in offsets[1:]]
    symbols = b"".join(_SYMBOL.pack(*fields) for fields in [(0,) * 6, *symbol])
    tags = [(_SONAME, soname_offset), (_HASH, hash_at), (_SYMBOLS, symbols_at), (_SYMBOL_SIZE, _SYMBOL.size)]
    tags += [(_STRINGS, strings_at), (_STRINGS_SIZE, len(strings)), (0, 0)]
    dynamic = b"".join(pack("<QQ", *tag) for tag in tags)
    content = _headers(end, dynamic_at, len(dynamic)) + chain + symbols + strings + _RETURN_ZERO
    return content.ljust(dynamic_at, b"\0") + dynamic


def _hash_table(n_symbols: int) -> bytes:
    """Return the symbol hash table: one bucket, whose chain has all symbols but the empty first; a multiple of 8
    bytes long."""
    following = [0, *range(2, n_symbols), 0][:n_symbols]
    table = pack(f"<{3 + n_symbols}I", 1, n_symbols, int(n_symbols > 1), *following)
    return table + bytes(-len(table) % 8)


def _headers(end: int, dynamic_at: int, dynamic_size: int) -> bytes:
    """Return the file header and the program headers: read and executable, writable, dynamic, and stack segments."""
    sizes = (_ELF_HEADER.size, _PROGRAM_HEADER.size, 4, _SECTION_HEADER.size, 0, 0)
    header = _ELF_HEADER.pack(b"\x7fELF\x02\x01\x01", _SHARED_OBJECT, _X86_64, 1, 0, _ELF_HEADER.size, 0, 0, *sizes)
    segments = [
        (_LOADED, _READ | _RUN, 0, end, _PAGE),
        (_LOADED, _READ | _WRITE, dynamic_at, dynamic_size, _PAGE),
        (_DYNAMIC, _READ | _WRITE, dynamic_at, dynamic_size, 8),
        (_STACK, _READ | _WRITE, 0, 0, 16),
    ]
    return header + b"".join(
        _PROGRAM_HEADER.pack(kind, flags, at, at, at, size, size, alignment)
        for kind, flags, at, size, alignment in segments
    )
