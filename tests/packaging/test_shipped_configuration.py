"""Shipped files for code hosts, containers and other tools name only existing files, commands and targets."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any

import pytest
import yaml

from tests.docs.shell import commands, fault
from tests.packaging.source_tree import PROJECT

YAML = sorted(
    path.relative_to(PROJECT).as_posix()
    for pattern in (".*.yaml", ".github/**/*.yml", "examples/**/*.yaml")
    for path in PROJECT.glob(pattern)
)


def _text(name: str) -> str:
    return (PROJECT / name).read_text(encoding="utf-8")


def _values(tree: Any, key: str) -> Iterator[Any]:
    """All values of a key, at any depth."""
    if isinstance(tree, dict):
        yield from (tree[key] for _ in range(key in tree))
        tree = list(tree.values())
    if isinstance(tree, list):
        for branch in tree:
            yield from _values(branch, key)


def _shell_of(name: str) -> list[str]:
    if name.endswith("Snakefile"):
        return re.findall(r'shell:\s*"(.*)"', _text(name))
    tree = yaml.safe_load(_text(name))
    return [str(value) for key in ("run", "cmd", "entry") for value in _values(tree, key)]


@pytest.mark.parametrize("name", YAML)
def test_every_yaml_file_is_a_mapping(name: str) -> None:
    assert isinstance(yaml.safe_load(_text(name)), dict)


def test_the_workflow_has_the_promised_jobs() -> None:
    assert set(yaml.safe_load(_text(".github/workflows/check.yml"))["jobs"]) == {
        *("check", "test", "wheel", "docs", "container"),
    }


@pytest.mark.parametrize(
    "name",
    [".github/workflows/check.yml", ".pre-commit-config.yaml", "examples/dvc/dvc.yaml", "examples/snakemake/Snakefile"],
)
def test_commands_of_configuration_exist(name: str) -> None:
    found = [words for text in _shell_of(name) for words in commands(re.sub(r"\$\{\{.*?\}\}|[{}]|\$\w+/", "", text))]
    assert found
    programs = {"chmod", "touch", "export"}
    assert {" ".join(words): why for words in found if words[0] not in programs and (why := fault(words, set()))} == {}


def test_the_container_copies_what_exists_and_is_let_through() -> None:
    copied = [
        word
        for line in re.findall(r"^COPY (?!--from)(.*)$", _text("Dockerfile"), re.MULTILINE)
        for word in line.split()[:-1]
    ]
    passed = {line[1:] for line in _text(".dockerignore").splitlines() if line.startswith("!")}
    assert copied
    assert [word for word in copied if not (PROJECT / word).exists()] == []
    assert {PurePosixPath(word).parts[0] for word in copied} == passed


def test_the_container_does_not_run_as_root() -> None:
    (number,) = re.findall(r"--uid (\d+) truing$", _text("Dockerfile"), re.MULTILINE)
    assert re.findall(r"^USER (\w+)$", _text("Dockerfile"), re.MULTILINE) == [number]


def test_the_development_container_is_json() -> None:
    assert json.loads(_text(".devcontainer/devcontainer.json"))["image"]


def test_the_documentation_host_builds_the_site_of_make_docs() -> None:
    reported = yaml.safe_load(_text(".readthedocs.yaml"))
    assert (PROJECT / reported["sphinx"]["configuration"]).is_file()
    assert reported["sphinx"]["fail_on_warning"] is True
    steps = reported["build"]["jobs"]["install"]
    assert all(isinstance(step, str) for step in steps), "a colon and a space make a mapping of a command"
