"""Read the project's source without importing it: files, and imports of each."""

from __future__ import annotations

import ast
from collections.abc import Container, Iterable, Iterator
from functools import cache
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
PACKAGES = ("schemas", "truing", "stages", "pipeline")  # from the ground up
BESIDE = ("schemas", "stages", "pipeline")  # installed as packages of `truing`
FOLDERS = (*PACKAGES, "tests", "benchmarks", "docs", "examples", "requirements", "sample_data", ".ci", ".github")
TEXT = {"", ".cfg", ".css", ".html", ".jinja", ".js", ".md", ".py", ".toml", ".txt", ".yaml", ".yml"}


def modules(folder: str) -> list[Path]:
    """Every Python file below a folder of the project."""
    return sorted((PROJECT / folder).rglob("*.py"))


def text_files() -> Iterator[Path]:
    """Every text file that belongs to the project (what a run or an installation made is left out)."""
    candidates = [*PROJECT.iterdir(), *(path for folder in FOLDERS for path in (PROJECT / folder).rglob("*"))]
    for path in candidates:  # in a linked work tree of git, `.git` is a file that names the place of the first
        if path.is_file() and path.suffix in TEXT and path.name != ".git" and "__pycache__" not in path.parts:
            yield path


def module_name(path: Path) -> str:
    """The dotted name of a Python file of the project: `truing.estimation.rigid_poses.rigid`."""
    parts = path.relative_to(PROJECT).with_suffix("").parts
    parts = ("truing", *parts) if parts[0] in BESIDE else parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_names(path: Path) -> set[str]:
    """Dotted names that a file imports anywhere; of `from a import b` both `a` and `a.b`."""
    found = _imports(path)
    return {*(origin for origin, _ in found), *(f"{origin}.{name}" for origin, name in found if name)}


def imported_modules(path: Path, known: Container[str]) -> set[str]:
    """Those of the known modules that a file imports anywhere; of `from a import b` only `a.b` where that is one."""
    named = ((origin, f"{origin}.{name}" if name else origin) for origin, name in _imports(path))
    found = {whole if whole in known else origin for origin, whole in named}
    return {name for name in found if name in known} - {module_name(path)}


@cache
def _imports(path: Path) -> list[tuple[str, str]]:
    """Imports anywhere in a file: modules (with an empty name), and modules with a name taken from them."""
    found = []
    for node in _statements(ast.parse(path.read_text(encoding="utf-8"), filename=str(path)).body):
        if isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [(_origin(node, path), alias.name) for alias in node.names]
    return found


def _statements(body: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """Every statement of a body at any depth; expressions, which are most of a tree, hold none."""
    for node in body:
        yield node
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            yield from _statements(getattr(node, part, ()))


def _origin(node: ast.ImportFrom, path: Path) -> str:
    """Return the absolute module of a `from` import."""
    if not node.level:
        return node.module or ""
    package = module_name(path).split(".")
    package = package[: len(package) + (path.name == "__init__.py") - node.level]
    return ".".join([*package, *([node.module] if node.module else [])])


def within(name: str, package: str) -> bool:
    """Return True if a dotted name is a package or lies inside it."""
    return name == package or name.startswith(package + ".")
