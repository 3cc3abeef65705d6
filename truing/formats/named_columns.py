"""Recognition of positions and attitudes by names and numbers of columns; not points of targets."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truing.arrays import Array
from truing.formats.guess import MappingKeys
from truing.formats.units import bare_and_unit, expanded

_FAMILIES = {
    "quaternion": (
        ("qw", "qx", "qy", "qz"),
        ("q0", "qx", "qy", "qz"),
        ("q0", "q1", "q2", "q3"),
        ("w", "i", "j", "k"),
        ("q1", "q2", "q3", "q4"),  # the real part may be the first or the last
    ),
    "vector": (("rx", "ry", "rz"), ("rotx", "roty", "rotz"), ("wx", "wy", "wz")),
    "euler": (
        ("roll", "pitch", "yaw"),
        ("roulis", "tangage", "lacet"),
        ("rollwinkel", "nickwinkel", "gierwinkel"),
        ("omega", "phi", "kappa"),
        ("alpha", "beta", "gamma"),
        ("a", "b", "c"),
    ),
}
_COLUMNS = {
    "quaternion": ("qw", "qx", "qy", "qz"),
    "vector": ("rx_rad", "ry_rad", "rz_rad"),
    "euler": ("euler_a_deg", "euler_b_deg", "euler_c_deg"),
}
_PLACES = (("x", "y", "z"), ("tx", "ty", "tz"), ("px", "py", "pz"))
_OF_PART = re.compile(
    r"(?:(?P<before>.*?)[\W_]+)?(?P<part>rot(?:ation)?|ori(?:entation)?|quat(?:ernion)?|q"
    r"|pos(?:ition)?|trans(?:lation)?|loc(?:ation)?|t|p)[\W_]+(?P<axis>[wxyz])",
    re.IGNORECASE,
)
_COMPOUND = re.compile(r"([a-z])([XYZ])(?![a-z])")  # MeasuredX
_PLACE = ("x_mm", "y_mm", "z_mm")
# Elements of a matrix, such as m_00, r12, T[0][3], H1_4: both numbers of one digit.
_ELEMENT = re.compile(r"(?P<before>.*?)(?P<row>[0-4])(?:[\W_]+)?(?P<column>[0-4])[\])]?")
_AXES = 3
_MATRICES = ((3, 3), (3, 4), (4, 4))
TOOL = "tool"  # body of measured poses that no file names
SHIFTS = ("m03", "m13", "m23")
_COMMANDED = re.compile(r"goal|command|cmd|desired|target|nominal|soll|set[ _]?point|planned|flange|reference", re.I)
# Bodies of motion capture: next to the base alone, the flange is no pose that a controller computes.
OF_BASE = re.compile(r"(robot[ _]?)?(base|basis|sockel|socle|world|fixed|fest)(?![^\W\d_])", re.I)
_OF_MEASURED = re.compile(r"(robot[ _]?)?(flange|reference)(?![^\W\d_])", re.I)
_SPREAD = re.compile(r"(?:^|[\W_])(?:std|sd|sigma|stdev|s|rms|unc|precision|prec|u|u95)(?:$|[\W_])", re.I)
_UNIT_NORM = 0.02
_ORTHONORMAL = 0.01
_FEWEST_ROWS = 2


@dataclass(frozen=True)
class PoseMapping:
    """Proposal for a table of poses: keys for [files.poses], raw columns that are no covariates, and points to
    check."""

    mapping: MappingKeys
    taken: tuple[str, ...]
    notes: tuple[str, ...]


def pose_columns(names: Sequence[str], values: Array) -> PoseMapping | None:
    """Return the poses recognised by names and numbers (N, W), NaN for other cells; else None."""
    plain = _without_words_of_parts(names)
    raw = dict(zip(plain, names, strict=True))
    groups = _raw_groups(raw, _PLACES)
    best: tuple[bool, int, str, tuple[str, ...], tuple[str, ...]] | None = None
    for before, group in groups.items():
        for rank, (kind, families) in enumerate(_FAMILIES.items()):
            turned = _raw_groups(raw, families).get(before)
            if turned is None or (kind == "quaternion" and not _is_unit(_selected_columns(names, turned, values))):
                continue
            candidate = (_COMMANDED.search(before) is not None, rank, kind, group, turned)
            best = min(best or candidate, candidate, key=lambda one: one[:2])
    if best is None:
        return _matrix_columns(names, values, groups)
    return _mapped(best[2], best[3], best[4], names, values)


def _matrix_columns(names: Sequence[str], values: Array, groups: Mapping[str, tuple[str, ...]]) -> PoseMapping | None:
    """Return the poses of columns that are numbered as elements of a matrix, such as ``T_00`` to ``T_23``; else None.

    A rotation of 3 x 3 needs coordinates next to it. The first number is the row, or the column if only that gives
    rigid motions.
    """
    for before, elements in _elements(names).items():
        size, width = 1 + max(row for row, _ in elements), 1 + max(column for _, column in elements)
        group = groups.get(before) or next(iter(groups.values()), ())
        if (size, width) not in _MATRICES or len(elements) != size * width or (width == _AXES and not group):
            continue
        raw = [[elements[row, column] for column in range(width)] for row in range(size)]
        cells = np.stack([_selected_columns(names, row, values) for row in raw], 1)
        known = cells[np.isfinite(cells).all(axis=(1, 2))]
        by_columns = size == width > _AXES and len(known) > 0 and are_motions(np.swapaxes(known, 1, 2))
        if by_columns:
            raw = [list(row) for row in zip(*raw, strict=True)]
        if len(known) and (by_columns or are_motions(known)):
            return _mapped_matrix(raw, group, names, values, by_columns=by_columns)
    return None


def _elements(names: Sequence[str]) -> dict[str, dict[tuple[int, int], str]]:
    """Return the columns whose names end in two numbers, by what is before them and by these, counted from 0."""
    numbered: dict[str, dict[tuple[int, int], str]] = {}
    for name in names:
        if match := _ELEMENT.fullmatch(name.strip()) or _ELEMENT.fullmatch(bare_and_unit(name)[0]):
            before = match["before"].rstrip(" _.-[(").casefold()
            numbered.setdefault(before, {})[int(match["row"]), int(match["column"])] = name
    counted = {}
    for before, elements in numbered.items():
        first = min(row for row, _ in elements)
        if first == min(column for _, column in elements):
            counted[before] = {(row - first, column - first): name for (row, column), name in elements.items()}
    return counted


def _mapped_matrix(
    raw: Sequence[Sequence[str]], group: tuple[str, ...], names: Sequence[str], values: Array, *, by_columns: bool
) -> PoseMapping:
    """Return the keys for matrices with raw columns ``raw`` (rows of 3 or 4), and coordinates next to those of 3."""
    columns = {f"m{i}{j}": name for i, row in enumerate(raw) for j, name in enumerate(row)}
    beside = () if "m03" in columns else group
    columns |= dict(zip(_PLACE, beside, strict=False))
    shifts = beside or tuple(columns[name] for name in SHIFTS)
    unit = bare_and_unit(shifts[0])[1]
    notes = [f"matrices of poses: {raw[0][0]} to {raw[-1][-1]}"]
    if by_columns:
        notes.append("the first number of their names is the column")
    if unit is None:
        notes.append(_range_words(_selected_columns(names, shifts, values)))
    mapping: MappingKeys = {"columns": columns, **({} if unit in (None, "mm") else {"unit": unit})}
    mapping["constants"] = {"body": TOOL}
    return PoseMapping(mapping, tuple(dict.fromkeys((*columns.values(), *_commanded(names)))), tuple(notes))


def _commanded(names: Sequence[str]) -> list[str]:
    return [name for name in names if _COMMANDED.search(name)]


def poses_side_by_side(names: Sequence[str], values: Array) -> list[PoseMapping]:
    """Return the poses of several bodies in each row (N, W), with a word before the names of columns as body.

    Commanded poses are no bodies.
    """
    plain = _without_words_of_parts(names)
    groups = _without_spreads(_groups(plain, _PLACES))
    columns_of_poses = []
    measured_groups = [before for before in groups if before and _COMMANDED.search(before) is None]
    is_beside_base = bool(measured_groups) and all(OF_BASE.match(before) for before in measured_groups)
    for before, group in groups.items():
        is_body = _COMMANDED.search(before) is None or (is_beside_base and _OF_MEASURED.match(before) is not None)
        for kind, families in _FAMILIES.items():
            turned = _groups(plain, families).get(before)
            if not before or turned is None or not is_body:
                continue
            raw = tuple(names[plain.index(name)] for name in (*group, *turned))
            if kind != "quaternion" or _is_unit(_selected_columns(names, raw[3:], values)):
                columns_of_poses.append((kind, raw[:3], raw[3:], group[0]))
                break
    bodies = _bodies_of([bare_and_unit(name)[0] for *_, name in columns_of_poses])
    mapped = [_mapped(kind, group, turned, names, values) for kind, group, turned, _ in columns_of_poses]
    return [
        replace(poses, mapping={**poses.mapping, "constants": {"body": body}})
        for poses, body in zip(mapped, bodies, strict=True)
    ]


def _without_spreads(groups: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Return the groups of columns that are not the uncertainties of another group, such as ``m_std_x`` of ``m_x``."""
    return {
        before: own
        for before, own in groups.items()
        if not any(
            all(is_spread_of(name, raw) for name, raw in zip(own, other, strict=True))
            for other in groups.values()
            if other is not own
        )
    }


def _without_words_of_parts(names: Sequence[str]) -> list[str]:
    """Return names without the words for position and rotation before their axes.

    ``Base.Rotation.X`` becomes ``Base.qx``, ``quat_x`` becomes ``qx``, and ``pos_x`` becomes ``x``. Rotations with a W
    are quaternions, others vectors or angles.
    """
    matches = [_OF_PART.fullmatch(bare_and_unit(name)[0]) for name in names]
    real = {m["before"] for m in matches if m is not None and m["axis"] in "wW"}
    names_left = []
    for name, match in zip(names, matches, strict=True):
        if match is None:
            names_left.append(name)
            continue
        letter = "" if match["part"][0] in "pPtTlL" else "q" if match["before"] in real else "r"
        before = f"{match['before']}." if match["before"] else ""
        names_left.append(f"{before}{letter}{match['axis'].lower()}")
    return names_left if len(set(names_left)) == len(names_left) else list(names)


def _bodies_of(names: Sequence[str]) -> list[str]:
    """Return the first word that differs in all names, without the last one; else the whole start of each name."""
    words = [[word for word in re.split(r"[\W_]+", name) if word][:-1] for name in names]
    if len({len(word) for word in words}) == 1:
        for column in zip(*words, strict=True):
            if len(set(column)) == len(names):
                return list(column)
    return [re.split(r"[\W_]+\w+$", name)[0] for name in names]


def _mapped(
    kind: str, group: tuple[str, ...], turned: tuple[str, ...], names: Sequence[str], values: Array
) -> PoseMapping:
    columns: MappingKeys = dict(zip(_PLACE, group, strict=True))
    notes = [f"poses: {', '.join((*group, *turned))}"]
    units: dict[str, str] = {}
    angles = _selected_columns(names, turned, values)
    reported = {bare_and_unit(name)[1] for name in turned}
    largest = float(np.nanmax(np.abs(angles))) if np.isfinite(angles).any() else 0.0
    in_degrees = reported == {"deg"} or (reported == {None} and largest > 2.0 * np.pi)
    if kind == "vector" and in_degrees:
        kind = "euler"  # rotation vectors are in radians, angles in degrees
        text = f"{turned[0]} to {turned[2]} reach {largest:.0f}: degrees"
        notes.append(f"{text}, so Euler angles; say their order, [poses] euler")
    elif kind == "vector":
        notes.append(f"{turned[0]} to {turned[2]} stay within {largest:.2g} rad")
    elif kind == "euler":
        notes.append("Euler angles: say their order, [poses] euler")
        if not in_degrees:
            units.update(dict.fromkeys(_COLUMNS["euler"], "rad"))
    elif bare_and_unit(turned[0])[0].casefold().endswith("q1"):
        notes.append(
            f"the real part of the quaternion is taken to be {turned[0]}; if it is {turned[3]}: qw is that one"
        )
    columns |= dict(zip(_COLUMNS[kind], turned, strict=True))
    unit = bare_and_unit(group[0])[1]
    mapping: MappingKeys = {"columns": columns, **({} if unit in (None, "mm") else {"unit": unit})}
    if unit is None:
        notes.append(_range_words(_selected_columns(names, group, values)))
    spread, coverage, more = _spreads(names, group, turned, kind)
    columns |= spread
    if "unit" in mapping:  # uncertainties may have another unit than the coordinates
        unit_of_column = {column: bare_and_unit(raw)[1] for column, raw in spread.items() if column.endswith("_mm")}
        units |= {
            column: unit_of_column_name
            for column, unit_of_column_name in unit_of_column.items()
            if unit_of_column_name not in (None, unit)
        }
    mapping |= ({"coverage": coverage} if coverage else {}) | ({"units": units} if units else {})
    mapping["constants"] = {"body": TOOL}
    used_names = (*group, *turned, *spread.values(), *_commanded(names))
    return PoseMapping(mapping, tuple(dict.fromkeys(used_names)), (*notes, *more))


def _range_words(values: Array) -> str:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return f"coordinates without unit, from {low:.4g} to {high:.4g}"


def _spreads(
    names: Sequence[str], group: tuple[str, ...], turned: tuple[str, ...], kind: str
) -> tuple[dict[str, str], float | None, list[str]]:
    """Return columns of uncertainties: named like coordinates or angles with an additional word."""
    spreads: dict[str, str] = {}
    factors: dict[str, float] = {}
    notes: list[str] = []
    wanted = dict(zip(_PLACE, group, strict=True))
    if kind != "quaternion":
        wanted |= dict(zip(_COLUMNS[kind], turned, strict=True))
    for column, raw in wanted.items():
        for name in names:
            if name == raw or not is_spread_of(name, raw):
                continue
            spreads[f"sigma_{column}"] = name
            if (reported := expanded(name)) is not None:
                factors[name] = reported.coverage
    if factors:
        factor = next(iter(factors.values()))
        text = f"{', '.join(factors)}: expanded uncertainties, taken to have k = {factor:g}"
        notes.append(f"{text}; coverage = 1 for one sigma")
        return spreads, factor, notes
    return spreads, None, notes


def is_spread_of(name: str, raw: str) -> bool:
    """True if a column holds the uncertainties of another one, by a word before, after or within its name."""
    bare = bare_and_unit(name)[0]
    return _SPREAD.search(bare) is not None and _bare_word(_SPREAD.sub("_", bare, count=1)) == _bare_word(
        bare_and_unit(raw)[0]
    )


def _bare_word(name: str) -> str:
    return re.sub(r"[\W_]+", "", name).casefold()


def _groups(names: Sequence[str], families: Sequence[tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Return columns of a family by their prefix: ``measurement_x``, ``measurement_y``, ... by ``measurement``."""
    by_word: dict[tuple[str, str], str] = {}
    for name in names:
        bare, _ = bare_and_unit(name)
        match = re.fullmatch(r"(?:(?P<before>.*?)[\W_]+)?(?P<word>[A-Za-z]+\d?)", bare)
        if match:
            by_word.setdefault(((match["before"] or "").casefold(), match["word"].casefold()), name)
    befores = dict.fromkeys(before for before, _ in by_word)
    groups: dict[str, tuple[str, ...]] = {}
    for before in befores:
        for family in families:
            if before not in groups and all((before, word) in by_word for word in family):
                groups[before] = tuple(by_word[before, word] for word in family)
    return groups


def position_groups(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the columns of coordinates by the words before their axes, such as ``base_x`` to ``base_z`` by base."""
    return _groups(names, _PLACES)


def _raw_groups(raw: Mapping[str, str], families: Sequence[tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Return columns of a family by their prefix, where ``raw`` gives the column of each plain name."""
    groups = _groups(tuple(raw), families)
    return {before: tuple(raw[name] for name in group) for before, group in groups.items()}


def place_columns(names: Sequence[str]) -> tuple[str, ...] | None:
    """Return columns of coordinates by their names, such as ``laser_x`` or ``MeasuredX``; measured ones first."""
    spelt = {_COMPOUND.sub(r"\1 \2", name): name for name in names}
    found = _groups(tuple(spelt), _PLACES)
    ranked = sorted(found.items(), key=lambda one: _COMMANDED.search(one[0]) is not None)
    return tuple(spelt[name] for name in ranked[0][1]) if ranked else None


def _selected_columns(names: Sequence[str], some: Sequence[str], values: Array) -> Array:
    return values[:, [list(names).index(name) for name in some]]


def _is_unit(quaternions: Array) -> bool:
    known = quaternions[np.isfinite(quaternions).all(axis=1)]
    return len(known) > 0 and bool(np.all(np.abs(np.linalg.norm(known, axis=1) - 1.0) < _UNIT_NORM))


def bare_poses(values: Array) -> PoseMapping | None:
    """Return the poses of a table (N, W) without names, recognised by numbers alone; else None."""
    rows, width = values.shape
    if not np.isfinite(values).all():
        return None
    body = {"constants": {"body": TOOL}}
    if width in (12, 16) and rows >= 1 and are_motions(values.reshape(rows, width // 4, 4)):
        names = [f"m{i}{j}" for i in range(width // 4) for j in range(4)]
        notes: tuple[str, ...] = (
            f"{width} numbers in a row are a matrix of a pose; its translation is taken for mm, else unit",
        )
        columns = {name: number + 1 for number, name in enumerate(names)}
        return PoseMapping({"columns": columns, **body, "number_rows": {"pose": 1}}, (), notes)
    whole_poses = values[: rows - rows % 4]
    if width == 4 and len(whole_poses) >= 4 * _FEWEST_ROWS and are_motions(whole_poses.reshape(-1, 4, 4)):
        notes = ("4x4 matrices, four rows each; their translation is taken for mm, else unit",)
        return PoseMapping({"rows_per_pose": 4, **body}, (), notes)
    first = width - 7
    if first in (0, 1) and rows >= _FEWEST_ROWS and _is_unit(values[:, -4:]):
        order = ("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
        columns = {name: first + number + 1 for number, name in enumerate(order)}
        reported = {} if first == 0 or not _counts(values[:, 0]) else {"pose": 1}
        numbered = {} if reported else {"number_rows": {"pose": 1}}
        notes = (
            "position and unit quaternion; the real part is taken to be the last number: else qw is the first of four",
            _range_words(values[:, first : first + 3]),
        )
        return PoseMapping({"columns": {**reported, **columns}, **body, **numbered}, (), notes)
    return None


def is_one_motion(values: Array) -> bool:
    """True if a small table is a single rigid motion: a transformation between two frames, not a measurement."""
    return values.shape in ((3, 4), (4, 4)) and bool(np.isfinite(values).all()) and are_motions(values[None])


def are_motions(matrices: Array) -> bool:
    """Return True if matrices (N, 3 or 4, 4) are rigid motions."""
    R = matrices[:, :3, :3]
    off = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max()
    closed = matrices.shape[1] == 3 or np.abs(matrices[:, 3] - [0.0, 0.0, 0.0, 1.0]).max() < _ORTHONORMAL
    return bool(off < _ORTHONORMAL and closed)


def _counts(column: Array) -> bool:
    """True if a column numbers the rows."""
    return bool(np.all(column == np.round(column)) and (len(column) < 2 or np.all(np.diff(column) == 1.0)))
