"""`truing init`: writes a campaign.toml for the raw files of a folder, to be completed."""

from __future__ import annotations

import fnmatch
import glob
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from truing.formats.file_search import is_raw_file
from truing.formats.guess import MappingKeys
from truing.formats.source import OF_IMAGES
from truing.pipeline.campaign_folder import FILE, suggested_folder
from truing.pipeline.console import RunConsole
from truing.pipeline.init_bodies_of_legs import with_renamed_bodies
from truing.pipeline.init_commanded_poses import without_commanded_poses
from truing.pipeline.init_entries import (
    RawGroup,
    bodies_and_targets,
    common_glob,
    distinguishing_pattern,
    glob_without_others,
    is_picture,
    network_tables,
    numbers_beside,
    photograph_entries,
    scanned_body,
)
from truing.pipeline.init_lists import with_numbered_poses, with_poses_in_order
from truing.pipeline.init_loads import with_loads_once
from truing.pipeline.init_log_at_times import with_log_at_times
from truing.pipeline.init_machine import with_bodies_of_legs
from truing.pipeline.init_names import with_bodies_of_survey, with_bodies_of_targets, with_poses_of_names
from truing.pipeline.init_parts import with_parts_of_one_list, with_stations
from truing.pipeline.init_prefixes import with_prefixed_survey
from truing.pipeline.init_questions import Answers, Ask, parsed_answers
from truing.pipeline.init_robot import (
    SUFFIX,
    Robot,
    guess_of_description,
    named_as_joints,
    needs_description,
    on_tip,
    robot_of,
    with_reflector,
)
from truing.pipeline.init_rows import next_steps
from truing.pipeline.init_run_columns import with_run_columns
from truing.pipeline.init_runs import with_runs_apart
from truing.pipeline.init_separate_loads import with_loads_apart
from truing.pipeline.init_separate_readings import with_measured_apart
from truing.pipeline.init_slides import with_slides
from truing.pipeline.init_survey import with_lost_points, with_survey, with_tip
from truing.pipeline.init_text import (
    LOADING_TABLES,
    NO_TABLE,
    campaign_text,
    kind_of_tables,
    listed_columns,
    printable,
    starter_campaign_text,
)
from truing.pipeline.init_times import with_poses_by_time
from truing.pipeline.problems import ExitCode, environment
from truing.pipeline.run_folder import PRIVATE
from truing.report.numbers import count_text
from truing.schemas.faults import CampaignFaults, Fault

if TYPE_CHECKING:
    from truing.formats.guess import Guess

    _File = tuple["RawGroup", Guess]

_APART = (
    "targets",
    "configurations",
    "scans",
    "surfaces",
)  # files that differ by words in their names are not one table
_AXES, _LONGER = 3, 4
_MOST_FILES = 5000
_SHOWN_FILES = 20  # files, or groups of these, whose first rows are shown
_LISTED = 20  # columns, on the screen
_NO_DESCRIPTION = (
    "needed: a description of the robot, which relates joints to points: put its URDF into the folder and call "
    "truing init again, or complete [mechanism] with its table of Denavit and Hartenberg"
)
_NO_JOINTS = (
    "needed: columns of the joints {joints} of {file}, of which there are not as many as it has joints: name them in "
    "columns of [files.configurations], or give joints of [mechanism] those that were read"
)
_OF_EACH_POSE = {"pose", "role", "time_s", "temperature_c"}
_NOT_RAW = {".toml", ".md", ".html", ".pdf", ".yaml", ".yml", ".json"}


def init_campaign(
    folder: Path, console: RunConsole, *, every_key: bool = False, answers: Sequence[str] = (), ask: Ask | None = None
) -> ExitCode:
    """Write the folder's campaign.toml, with all keys or with those that this campaign needs.

    answers: ``key=value`` or ``glob:key=value`` on open points of the files. ask: how others are asked; None: they stay
    guesses. Raises CampaignFaults if the folder is missing or has a campaign.toml, or if an answer is invalid.
    """
    given = parsed_answers(answers)
    target = folder / FILE
    if not folder.is_dir():
        raise CampaignFaults(
            [Fault(str(folder), f"a folder that exists, with raw files in it{suggested_folder(folder)}")]
        )
    robot = robot_of(folder, list(_files(folder)))
    guesses = _joined_groups([(group, _guess(group, robot)) for group in _raw_groups(folder)])
    guesses = network_tables(_with_surfaces(_rows_once(_separate_tables(_separate_globs(guesses))))) + _photographs(
        folder
    )
    if os.path.lexists(target):
        raise CampaignFaults([_never_overwritten(target)])
    guesses = _read_together(folder, guesses, robot)
    all_answers = Answers(given) if ask is None else Answers(given, ask)
    guesses = _settled(folder, guesses, all_answers, console)
    all_answers.raise_faults()
    guesses, runs = with_runs_apart(folder, guesses)
    name = folder.resolve().name
    text = campaign_text(name, guesses, robot) if every_key else starter_campaign_text(name, guesses, robot)
    _write_new(target, text)
    has_tables = any(guess.table is not None for _, guess in guesses)
    after = f"complete it, then: truing check {folder}" if has_tables else "no file of the folder is read yet"
    console.written(f"wrote {target}; {after}", [target])
    for point in all_answers.open_points():
        console.add_fact("open_points", point)
        if not point["answered"]:
            taken = f"taken as {point['taken']}" if point["taken"] else "to be completed"
            where, key = printable(str(point["path"])), point["key"]
            console.line(f"open: {where}, {point['question']}: {taken} (else: --answer {key}=...)")
    for words in (*runs, *next_steps(guesses)):
        console.sentence(words)
    if needs_description(robot, [guess for _, guess in guesses]):
        of_robot = "" if robot is None else _NO_JOINTS.format(joints=", ".join(robot.joints), file=robot.file)
        console.sentence(of_robot or _NO_DESCRIPTION)
    if all_answers.used:
        console.line(f"the same answers again: {all_answers.command(folder, every_key=every_key)}")
    return ExitCode.DONE


def _read_together(folder: Path, guesses: list[_File], robot: Robot | None) -> list[_File]:
    """Return the guesses of files as their names, the other files and the robot's description complete them."""
    guesses = with_run_columns(folder, without_commanded_poses(guesses))
    guesses = with_measured_apart(folder, with_loads_apart(folder, with_loads_once(folder, guesses)))
    guesses = with_parts_of_one_list(folder, with_slides(folder, _with_keys_of_names(guesses)))
    guesses = with_numbered_poses(folder, with_lost_points(folder, guesses), robot)
    guesses = with_log_at_times(folder, guesses, robot)
    guesses = with_poses_by_time(folder, with_poses_in_order(folder, with_stations(folder, guesses)))
    guesses = with_poses_of_names(folder, guesses)
    guesses = with_survey(folder, guesses)
    guesses = [(group, changed) for (group, _), changed in zip(guesses, with_reflector(guesses, robot), strict=True)]
    guesses = [
        (group, changed) for (group, _), changed in zip(guesses, on_tip([g for _, g in guesses], robot), strict=True)
    ]
    guesses = with_bodies_of_survey(folder, with_bodies_of_targets(folder, guesses))
    guesses = with_prefixed_survey(folder, guesses)
    guesses = [(group, changed) for (group, _), changed in zip(guesses, with_tip(folder, guesses, robot), strict=True)]
    guesses = with_renamed_bodies(folder, guesses)
    named = with_bodies_of_legs([guess for _, guess in guesses])
    return [(group, changed) for (group, _), changed in zip(guesses, named, strict=True)]


def _settled(folder: Path, guesses: list[_File], answers: Answers, console: RunConsole) -> list[_File]:
    """Show each file as it is understood, and settle its open points."""
    has_points = any(guess.table == "points" for _, guess in guesses)
    result = []
    for number, (group, guess) in enumerate(guesses):
        words = _summary(group, guess)
        console.line(f"{printable(group.glob)}: {words}")
        console.add_fact(
            "inputs", {"path": group.path or group.glob, "files": group.count, "table": guess.table, "summary": words}
        )
        is_shown = number < _SHOWN_FILES
        if is_shown:
            _show(folder, group, guess, console)
        is_survey = has_points or group.glob == "targets.csv"
        settled = answers.settled(group.glob, guess, is_only_table=not is_survey)
        if is_shown and (settled.mapping, settled.table) != (guess.mapping, guess.table):
            console.line("by these answers:")
            _show(folder, group, settled, console)
        result.append((group, settled))
    return result


def _show(folder: Path, group: RawGroup, guess: Guess, console: RunConsole) -> None:
    """Print the first rows of a file by its guess."""
    from truing.pipeline.init_preview import preview

    if guess.table is None or guess.known:
        return
    files = [group.example.parent / name for name in group.names] or [group.example]
    rows = preview(folder, files, guess.table, kind_of_tables(Counter([guess.table])), guess.mapping)
    if rows is not None and rows.fault:
        console.line(f"  not readable yet: {printable(rows.fault)}")
    elif rows is not None:
        console.show(rows.columns, rows.rows)


def _with_keys_of_names(guesses: list[_File]) -> list[_File]:
    """Add to each guess the pose, target or body in its file names, and a separate run to each single file."""
    tables = Counter(guess.table for _, guess in guesses)
    return [(group, _with_keys(group, guess, tables)) for group, guess in guesses]


def _with_keys(group: RawGroup, guess: Guess, tables: Counter[str | None]) -> Guess:
    ways = tuple(replace(way, guess=_with_keys(group, way.guess, tables)) for way in guess.ways)
    mapping = _whole_mapping(group, guess, tables)
    differing = numbers_beside(group.names, mapping.get("from_name", "")) if guess.table == "points" else ""
    if not differing:
        return replace(guess, mapping=mapping, ways=ways)
    doubt = f"the files' names differ also in {differing}: rows of the same number are assumed to be the same pose in "
    doubt += "all files (else: an entry for each kind of file, with an offset of its poses)"
    return replace(guess, mapping=mapping, ways=ways, doubts=(*guess.doubts, doubt))


def _whole_mapping(group: RawGroup, guess: Guess, tables: Counter[str | None]) -> MappingKeys:
    mapping = _with_names(group, {**guess.mapping, **_body_from_name(group, guess)}, guess)
    constants = mapping.get("constants", {})
    if tables[guess.table] > 1 and group.count == 1 and guess.table in LOADING_TABLES and "run" in constants:
        return {**mapping, "constants": {**constants, "run": Path(group.example).stem}}  # each entry has its own
    return mapping


def _photographs(folder: Path) -> list[tuple[RawGroup, Guess]]:
    pictures = [path for path in _files(folder) if is_picture(path) and _is_text(str(path.relative_to(folder)))]
    entries = photograph_entries(folder, pictures)
    return [(RawGroup(pattern, example, count), guess) for pattern, example, count, guess in entries]


def _write_new(target: Path, text: str) -> None:
    content = text.encode()
    with environment(f"{target} cannot be written"):
        try:
            file = open(target, "xb")  # noqa: SIM115 (closed below; who opens it first, owns it)
        except FileExistsError:
            raise CampaignFaults([_never_overwritten(target)]) from None
        try:
            with file:
                file.write(content)
        except BaseException:
            target.unlink(missing_ok=True)  # an incomplete file would never be overwritten
            raise


def _never_overwritten(target: Path) -> Fault:
    return Fault(str(target), "no campaign.toml yet, because it is never overwritten")


def _raw_groups(folder: Path) -> list[RawGroup]:
    """Files below a folder except photographs, grouped if their names differ only in numbers."""
    groups: dict[str, list[Path]] = {}
    for path in _files(folder):
        if is_picture(path):
            continue
        relative = path.relative_to(folder)
        name = re.sub(r"\d+", "*", glob.escape(relative.name))
        pattern = (Path(glob.escape(str(relative.parent))) / name).as_posix()
        groups.setdefault(pattern, []).append(path)
    return [_group(folder, pattern, paths) for pattern, paths in sorted(groups.items())]


def _group(folder: Path, pattern: str, paths: list[Path]) -> RawGroup:
    glob = pattern if len(paths) > 1 else paths[0].relative_to(folder).as_posix()
    return RawGroup(glob, paths[0], len(paths), tuple(path.name for path in paths))


def _files(folder: Path) -> Iterator[Path]:
    """Raw files below a folder, except hidden files, descriptions and results of a run."""
    count = 0
    results = {mark.parent for mark in folder.rglob(PRIVATE)}
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if (
            not hidden
            and is_raw_file(path)
            and path.suffix.lower() not in _NOT_RAW
            and results.isdisjoint(path.parents)
        ):
            count += 1
            if count > _MOST_FILES:
                return
            yield path


def _guess(group: RawGroup, robot: Robot | None) -> Guess:
    from truing.formats.guess import Guess
    from truing.formats.nominal_machine import with_convention
    from truing.formats.sniff import sniff_file

    if not _is_text(group.glob):
        return Guess(notes=("its name is not UTF-8 text, as campaign.toml requires: rename it",))
    if group.example.suffix.lower() == SUFFIX:
        return guess_of_description(group.example, robot)
    guess = named_as_joints(sniff_file(group.example, () if robot is None else robot.joints), robot)
    guess = with_convention(guess, group.example.stem)
    is_known_points = group.glob == "known_points.csv" and "point" in guess.columns  # no survey of a body
    if is_known_points or (guess.table is None and group.glob in [f"{table}.csv" for table in OF_IMAGES]):
        return replace(guess, mapping={}, table=group.example.stem)
    # A survey is one file: many of them, which differ by a number, are poses.
    return replace(guess, table="points") if guess.table == "targets" and group.count > 1 else guess


def _joined_groups(guesses: list[tuple[RawGroup, Guess]]) -> list[tuple[RawGroup, Guess]]:
    """Join groups that are read by the same keys, if a glob finds exactly these files."""
    everything = [str(Path(group.glob).parent / name) for group, _ in guesses for name in group.names]
    alike: dict[str, list[tuple[RawGroup, Guess]]] = {}
    for group, guess in guesses:
        where = (Path(group.glob).parent, Path(group.example).suffixes[-1:])
        single = not guess.columns or guess.table in _APART
        alike.setdefault(group.glob if single else repr((where, guess)), []).append((group, guess))
    return [entry for group_entries in alike.values() for entry in _group_by_glob(group_entries, everything)]


def _group_by_glob(group_entries: list[tuple[RawGroup, Guess]], everything: list[str]) -> list[tuple[RawGroup, Guess]]:
    if len(group_entries) == 1:
        return group_entries
    parent, guess = Path(group_entries[0][0].glob).parent, group_entries[0][1]
    names = tuple(name for group, _ in group_entries for name in group.names)
    pattern = str(parent / common_glob(names))
    if sorted(fnmatch.filter(everything, pattern)) != sorted(str(parent / name) for name in names):
        return group_entries
    return [(RawGroup(pattern, group_entries[0][0].example, len(names), names), guess)]


def _separate_globs(guesses: list[tuple[RawGroup, Guess]]) -> list[tuple[RawGroup, Guess]]:
    """Give each group a glob that finds no file of another group."""
    held: dict[Path, list[str]] = {}
    for group, _ in guesses:
        held.setdefault(Path(group.glob).parent, []).extend(group.names)
    paths = (glob_without_others(group.glob, group.names, held[Path(group.glob).parent]) for group, _ in guesses)
    return [(replace(group, path=path), guess) for (group, guess), path in zip(guesses, paths, strict=True)]


def _separate_tables(guesses: list[tuple[RawGroup, Guess]]) -> list[tuple[RawGroup, Guess]]:
    """One entry for each table of a file with several tables."""
    return [
        (group, part) for group, guess in guesses for part in (replace(guess, other_tables=()), *guess.other_tables)
    ]


def _rows_once(guesses: list[tuple[RawGroup, Guess]]) -> list[tuple[RawGroup, Guess]]:
    """Leave out what else a file of poses has, where another file has the readings: each pose has one row of
    configurations."""
    of_poses = {group.glob for group, guess in guesses if guess.table == "poses"}
    elsewhere = any(guess.table == "configurations" and group.glob not in of_poses for group, guess in guesses)

    def is_second(group: RawGroup, guess: Guess) -> bool:
        holds_readings = set(guess.mapping.get("columns", {})) - _OF_EACH_POSE
        return elsewhere and guess.table == "configurations" and group.glob in of_poses and not holds_readings

    return [(group, guess) for group, guess in guesses if not is_second(group, guess)]


def _with_surfaces(guesses: list[tuple[RawGroup, Guess]]) -> list[tuple[RawGroup, Guess]]:
    """Among dense scans, many files are poses, and a separate file is their reference surface."""
    poses = any(guess.table == "scans" and group.count > 1 for group, guess in guesses)
    return [
        (group, replace(guess, table="surfaces") if poses and guess.table == "scans" and group.count == 1 else guess)
        for group, guess in guesses
    ]


def _summary(group: RawGroup, guess: Guess) -> str:
    if guess.table == "images":
        return count_text(group.count, "photograph")
    many = f"{group.count} files, " if group.count > 1 else ""
    if guess.known:
        return printable(f"{many}{guess.notes[0]}")
    if guess.table is None and guess.notes and not guess.columns:
        return printable(f"{many}not recognised: {guess.notes[0]}")
    content = guess.table or f"not recognised: {guess.notes[0] if guess.notes else NO_TABLE}"
    return printable(f"{many}{content}; columns {listed_columns(guess.columns, _LISTED)}")


def _is_text(name: str) -> bool:
    """True if a file's name is valid text; other bytes appear as surrogates in Python."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _with_names(group: RawGroup, mapping: MappingKeys, guess: Guess) -> MappingKeys:
    """Keys for a group's files, with the pose or target in their names."""
    named = {*guess.columns, *mapping.get("columns", {}), *mapping.get("number_rows", {})}
    style = mapping.get("format")
    has_runs_in_names = "run" in mapping.get("constants", {}) and "from_name" not in mapping
    if guess.table in LOADING_TABLES and group.count > 1 and has_runs_in_names:
        other_constants = {key: value for key, value in mapping["constants"].items() if key != "run"}
        other_keys = {key: value for key, value in mapping.items() if key != "constants"}
        return {
            **other_keys,
            **({"constants": other_constants} if other_constants else {}),
            **distinguishing_pattern(group.names, "run"),
        }
    if guess.table == "image_points" and "image" not in named and "x_px" in named:
        return _image_by_name(group, mapping)
    if guess.table == "image_points" and group.count > 1 and mapping.get("constants") == {"pose": 1}:
        other_keys = {key: value for key, value in mapping.items() if key != "constants"}
        return {**other_keys, **distinguishing_pattern(group.names, "pose")}
    if guess.table in ("poses", "configurations") and group.count > 1 and "pose" in mapping.get("number_rows", {}):
        return {
            **mapping,
            "number_rows": {"row": 1},
            **distinguishing_pattern(group.names, "set"),
            "join": {"pose": "{set}-{row}"},
        }
    if guess.table not in ("points", "scans") or group.count == 1:
        return mapping
    if group.example.suffix.lower() in (".c3d", ".trc"):
        return {**mapping, **distinguishing_pattern(group.names, "trial"), "join": {"pose": "{trial}-{frame}"}}
    if style == "tracker" or (style is None and _rows_are_poses(group, guess)):
        parts_of_name = bodies_and_targets(group.names)
        if "(?P<body>" in parts_of_name.get("from_name", ""):
            mapping = {key: value for key, value in mapping.items() if key != "constants"}
        return {**mapping, **parts_of_name, **({} if style else {"number_rows": {"pose": 1}})}
    return mapping if "pose" in named else {**mapping, **distinguishing_pattern(group.names, "pose")}


def _image_by_name(group: RawGroup, mapping: MappingKeys) -> MappingKeys:
    """Keys for files of one image each: their names tell the image, and the pose if they count it."""
    from truing.formats.named_pixels import pattern_of_images

    if group.count == 1:
        constants = {**mapping.get("constants", {}), "image": Path(group.example).stem}
        return {**mapping, "constants": constants}
    if (pattern := pattern_of_images(group.names)) is None or "pose" in mapping.get("columns", {}):
        return {**mapping, **distinguishing_pattern(group.names, "image")}
    return {**{key: value for key, value in mapping.items() if key != "constants"}, "from_name": pattern}


def _rows_are_poses(group: RawGroup, guess: Guess) -> bool:
    """True if each of a few long files of bare coordinates holds one target, with poses as rows."""
    from truing.formats.compression import open_plain

    if set(guess.mapping.get("columns", {})) != {"x_mm", "y_mm", "z_mm"} or len(guess.columns) != _AXES:
        return False
    with open_plain(group.example) as stream:
        rows = stream.read(1 << 16).count(b"\n")
    return rows >= _LONGER * group.count


def _body_from_name(group: RawGroup, guess: Guess) -> MappingKeys:
    """Body of scans and surfaces: the word of the file's name that does not mean scan."""
    if guess.table not in ("scans", "surfaces"):
        return {}
    return {"constants": {"body": scanned_body(group.glob)}}
