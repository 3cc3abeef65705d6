"""Compilation of functions over arrays with numba, cached on disk next to their source where that is possible.

Importing this module imports numba.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import config

# numba reads settings from `.numba_config.yaml` in the current folder, including the place of compiled code to load.
# Environment variables set the same; a file in the folder of somebody's data must not change them.
config._config_fname = os.devnull
config.reload_config()

_MODE: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "nsz"}}
# Always inlined. numba also compiles each of these separately: fresh code would call that copy, cached code its own,
# and the two, optimised in different contexts, differ in the last bits.
_BARE: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "forceinline": True}
inner = njit(**_MODE, **_BARE)  # for functions that only compiled code calls
summing = njit(**{**_MODE, "fastmath": {*_MODE["fastmath"], "reassoc"}}, **_BARE)  # the same, for sums in any order


def compiled(*made_of: str, is_exact: bool = False) -> Callable[[Callable], Callable]:
    """Return a decorator that compiles at the first call, and caches the code next to its source if possible.

    made_of: source files of the code. numba only notices changes of the function's own file. A digest of all files
    therefore becomes part of the names of function and cache file. is_exact: round every operation as IEEE 754 does.
    """
    digest = hashlib.sha256(b"".join(Path(name).read_bytes() for name in (__file__, *made_of))).hexdigest()[:12]
    mode = {**_MODE, "fastmath": False} if is_exact else _MODE

    def decorate(function: Callable) -> Callable:
        function.__qualname__ += "_" + digest
        if not can_cache(Path(made_of[0]).parent):
            return njit(**mode)(function)
        try:
            return njit(**mode, cache=True)(function)
        except RuntimeError:  # numba found no place for the cache
            return njit(**mode)(function)

    return decorate


def can_cache(folder: Path) -> bool:
    """True if there is a cache folder next to the source, or one named by the user; otherwise numba would use
    the user's folder."""
    beside = folder / "__pycache__"
    return "NUMBA_CACHE_DIR" in os.environ or os.access(beside if beside.is_dir() else folder, os.W_OK)
