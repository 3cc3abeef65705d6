"""Packages of the checkout by folder: all are installed below the one name `truing`."""

from pathlib import Path

from setuptools import setup

ROOMS = {"truing": "truing", "truing.schemas": "schemas", "truing.stages": "stages", "truing.pipeline": "pipeline"}


def packages(name: str, folder: str) -> list[str]:
    """The package that a folder is, and all below it."""
    inner = (path.parent.relative_to(folder).parts for path in sorted(Path(folder).rglob("__init__.py")))
    return [".".join((name, *parts)) for parts in inner]


setup(
    package_dir=ROOMS,
    packages=[package for name, folder in ROOMS.items() for package in packages(name, folder)],
)
