"""Names of covariates: a laboratory's own, kept apart from every name that means something else in a run.

A covariate may bear any name that is no column of its own table. Where tables meet, and where the program has a name of
its own, such as the order of the poses, the covariate stands under `column_alias` of its name; what people read says
`own_name`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from urllib.parse import quote, unquote

_MARK = "covariate:"
# Raw columns of tables of loads, and what stages add to them: a covariate of one is a column of another.
OF_LOADS = frozenset(
    (
        *("load_axis", "load", "channel", "reading", "unit", "sigma", "role"),
        *("signal_x", "signal_y", "phase_deg", "radius"),
        *("dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad"),
        *("shown_fx_n", "shown_fy_n", "shown_fz_n", "shown_mx_nm", "shown_my_nm", "shown_mz_nm"),
    )
)
# What the diagnosis calls things that no column holds, and the columns of the plan of what to measure next.
_OF_DIAGNOSIS = frozenset(
    (
        *("order", "approach", "last step", "memory", "own drive", "time_in_run_s", "held_out"),
        *("purpose", "pose", "run", "times", "conditions", "expected", "repeat_of"),
        *("need", "measurements", "duration_s", "sigma_now", "sigma_expected", "odds_expected"),
    )
)
_OF_PROGRAM = re.compile(r"(approach|unloading|largest so far|direction of) .*|.* [xyz]|.*\*.*|v[1-8]_mv", re.DOTALL)
_LISTED = re.compile(r'"((?:[^"]|"")*)"|(\S+)')


def column_alias(column: str) -> str:
    """Return what a covariate stands under beside the program's own names; its own name where none is like it."""
    is_taken = column in OF_LOADS or column in _OF_DIAGNOSIS or _OF_PROGRAM.fullmatch(column)
    return marked(column) if is_taken and not is_marked(column) else column


def marked(name: str) -> str:
    """Return a name that no column and no name of the program bears."""
    return _MARK + quote(name, safe="")


def is_marked(column: str) -> bool:
    """Whether a column stands under a name of `marked`."""
    return column.startswith(_MARK)


def own_name(column: str) -> str:
    """Return the name that the laboratory gave a column."""
    return unquote(column.removeprefix(_MARK)) if is_marked(column) else column


def listed(columns: Iterable[str]) -> str:
    """Return the laboratory's names of columns, separated by blanks; a name with a blank or a quote within quotes."""
    return " ".join(_quoted(own_name(column)) for column in columns)


def named(text: str) -> tuple[str, ...]:
    """Return the names in a text of `listed`."""
    return tuple(plain or quoted.replace('""', '"') for quoted, plain in _LISTED.findall(text))


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if re.search(r'[\s"]', name) or not name else name
