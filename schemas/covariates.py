"""Names of covariates, distinct from all other names of a run.

A covariate may have any name that is not a column of its own table. In joined tables it is stored under `column_alias`
of its name. So is one whose name the program uses itself, such as the order of the poses. Texts show `own_name`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from urllib.parse import quote, unquote

_MARK = "covariate:"
# Columns of load tables, raw or added by stages: a covariate of one table may be a column of another.
OF_LOADS = frozenset(
    (
        *("load_axis", "load", "channel", "reading", "unit", "sigma", "role"),
        *("signal_x", "signal_y", "phase_deg", "radius"),
        *("dx_mm", "dy_mm", "dz_mm", "rx_rad", "ry_rad", "rz_rad"),
        *("shown_fx_n", "shown_fy_n", "shown_fz_n", "shown_mx_nm", "shown_my_nm", "shown_mz_nm"),
    )
)
# Names of the diagnosis for quantities without a column, and columns of the plan of next measurements.
_OF_DIAGNOSIS = frozenset(
    (
        *("order", "approach", "last step", "memory", "path", "own drive", "time_in_run_s", "held_out"),
        *("purpose", "pose", "run", "times", "conditions", "expected", "repeat_of"),
        *("need", "measurements", "duration_s", "sigma_now", "sigma_expected", "odds_expected"),
    )
)
_OF_PROGRAM = re.compile(
    r"(approach|unloading|largest so far|direction of) .*|(stop|relaxing) \d+|.* [xyz]|.*\*.*|v[1-8]_mv", re.DOTALL
)
_LISTED = re.compile(r'"((?:[^"]|"")*)"|(\S+)')


def column_alias(column: str) -> str:
    """Return the column name of a covariate: its own name, or a marked one if the program uses that name."""
    is_taken = column in OF_LOADS or column in _OF_DIAGNOSIS or _OF_PROGRAM.fullmatch(column)
    return marked(column) if is_taken and not is_marked(column) else column


def marked(name: str) -> str:
    """Return a name that no column and no quantity of the program has."""
    return _MARK + quote(name, safe="")


def is_marked(column: str) -> bool:
    """True if a column has a name made by `marked`."""
    return column.startswith(_MARK)


def own_name(column: str) -> str:
    """Return the laboratory's name of a column."""
    return unquote(column.removeprefix(_MARK)) if is_marked(column) else column


def listed(columns: Iterable[str]) -> str:
    """Return the laboratory's names of columns, separated by blanks; names with a blank or quote are quoted."""
    return " ".join(_quoted(own_name(column)) for column in columns)


def names_in(text: str) -> tuple[str, ...]:
    """Return the names in a text made by `listed`."""
    return tuple(plain or quoted.replace('""', '"') for quoted, plain in _LISTED.findall(text))


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if re.search(r'[\s"]', name) or not name else name
