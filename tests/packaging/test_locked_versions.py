"""The lock files are complete, have hashes and no index address, and agree with pyproject.toml."""

from __future__ import annotations

import re
import tomllib

import pytest

from tests.packaging.source_tree import PROJECT

PYPROJECT = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = PYPROJECT["project"]["optional-dependencies"]
RUNTIME = [*PYPROJECT["project"]["dependencies"], *PYPROJECT["build-system"]["requires"]]


def lock(name: str) -> str:
    return (PROJECT / "requirements" / f"{name}.txt").read_text(encoding="utf-8")


def pins(name: str) -> dict[str, set[str]]:
    """Versions by package; more than one where platforms differ."""
    found: dict[str, set[str]] = {}
    for package, version in re.findall(r"^([a-z0-9-]+)==(\S+)", lock(name), flags=re.MULTILINE):
        found.setdefault(package, set()).add(version)
    return found


def distribution(requirement: str) -> str:
    match = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert match
    return re.sub(r"[._]+", "-", match.group()).lower()


@pytest.mark.parametrize("name", ["runtime", "dev"])
def test_every_locked_version_has_hashes(name: str) -> None:
    entries = re.split(r"\n(?=\S)", lock(name).strip())
    assert len(entries) == sum(len(versions) for versions in pins(name).values())
    assert all(re.search(r"--hash=sha256:[0-9a-f]{64}", entry) for entry in entries)


@pytest.mark.parametrize("name", ["runtime", "dev"])
def test_locks_hold_no_index_address(name: str) -> None:
    assert not re.search(r"://|index-url|find-links|trusted-host", lock(name))


@pytest.mark.parametrize(("name", "required"), [("runtime", RUNTIME), ("dev", [*RUNTIME, *EXTRAS["dev"]])])
def test_all_that_pyproject_asks_for_is_locked(name: str, required: list[str]) -> None:
    assert {distribution(requirement) for requirement in required} <= set(pins(name))


def test_tests_run_on_the_versions_that_users_get() -> None:
    tested = pins("dev")
    assert {name: tested.get(name) for name in pins("runtime")} == pins("runtime")


def test_the_build_is_locked_with_the_rest() -> None:
    assert EXTRAS["build"] == PYPROJECT["build-system"]["requires"]
