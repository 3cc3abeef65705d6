"""What a stage's code consists of: its module, all it imports from the project, and the data files beside them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from pipeline.remembered import RememberedDigests

ROOMS = ("schemas", "truing", "stages")  # what a stage can be made of
_DATA_FILES = {".css", ".csv", ".html", ".jinja", ".js", ".json", ".toml"}


def source_digests(root: Path, modules: tuple[str, ...], remembered: RememberedDigests) -> dict[str, str]:
    """SHA-256 of each file (path relative to ``root``) that ``modules`` execute, directly or through imports.

    A package's ``__init__`` counts where a name is taken from it, not where it merely lies on the way to a module.
    """
    pending = [path for name in modules if (path := _module_file(root, name)) is not None]
    found: dict[Path, str] = {}
    while pending:
        path = pending.pop()
        if path in found:
            continue
        found[path] = remembered.digest(path)
        names = _imports(root, path, found[path], remembered)
        pending.extend(target for name in names if (target := _resolve(root, name)) is not None)
    for folder in sorted({path.parent for path in found}):
        found.update({path: remembered.digest(path) for path in _data_files(folder)})
    return {path.relative_to(root).as_posix(): found[path] for path in sorted(found)}


def _module_file(root: Path, name: str) -> Path | None:
    place = root.joinpath(*name.split("."))
    for candidate in (place.with_suffix(".py"), place / "__init__.py"):
        if candidate.is_file():
            return candidate
    return None


def _resolve(root: Path, name: str) -> Path | None:
    """The file behind ``package.module`` or ``package.module:attribute``."""
    module, _, attribute = name.partition(":")
    inner = _module_file(root, f"{module}.{attribute}") if attribute else None
    return inner or _module_file(root, module)


def _imports(root: Path, path: Path, digest: str, remembered: RememberedDigests) -> list[str]:
    package = ".".join(path.relative_to(root).parent.parts)
    key = f"imports of {package} {digest}"
    known = remembered.fact(key)
    if known is None:
        known = sorted(set(_executed_imports(ast.parse(path.read_bytes()), package)))
        remembered.note(key, known)
    return list(known)


def _executed_imports(node: ast.AST, package: str) -> Iterator[str]:
    """Project modules that ``node`` imports at any depth, except those for type checkers only."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names if _is_ours(alias.name))
    elif isinstance(node, ast.ImportFrom):
        yield from _from_import(node, package)
    elif isinstance(node, ast.Constant):
        yield from _named_module(node.value)
    else:
        skipped = node.body if isinstance(node, ast.If) and _is_type_checking(node.test) else ()
        for child in ast.iter_child_nodes(node):
            if child not in skipped:
                yield from _executed_imports(child, package)


def _from_import(node: ast.ImportFrom, package: str) -> Iterator[str]:
    base = node.module or ""
    if node.level:
        parents = package.split(".")[: len(package.split(".")) - node.level + 1]
        base = ".".join([*parents, *([node.module] if node.module else [])])
    if _is_ours(base):
        yield from (f"{base}:{alias.name}" for alias in node.names)


def _named_module(value: object) -> Iterator[str]:
    """A string that is a dotted name in one of the rooms: how modules are named for importing them late."""
    if not isinstance(value, str) or "." not in value or not _is_ours(value):
        return
    if all(part.isidentifier() for part in value.split(".")):
        yield value


def _is_ours(name: str) -> bool:
    return name.split(".")[0] in ROOMS


def _is_type_checking(test: ast.expr) -> bool:
    return (isinstance(test, ast.Name) and test.id == "TYPE_CHECKING") or (
        isinstance(test, ast.Attribute) and test.attr == "TYPE_CHECKING"
    )


def _data_files(folder: Path) -> Iterator[Path]:
    """Files that a package carries beside its modules, in subfolders too unless those are packages themselves."""
    for entry in folder.iterdir():
        if entry.is_file() and entry.suffix in _DATA_FILES:
            yield entry
        elif entry.is_dir() and _is_plain_folder(entry):
            yield from _data_files(entry)


def _is_plain_folder(folder: Path) -> bool:
    hidden = folder.name.startswith((".", "__"))
    return not hidden and not (folder / "__init__.py").exists()
