"""No module imports itself by way of others; imports within functions and for types count."""

from __future__ import annotations

from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

from tests.packaging.source_tree import PACKAGES, imported_modules, module_name, modules


def circles(imports: Mapping[str, set[str]]) -> list[str]:
    """Chains of imports that end where they begin, one for every import that would have to go."""
    left = {name: set(used) for name, used in imports.items()}
    found = []
    while True:
        try:
            TopologicalSorter(left).prepare()
        except CycleError as error:
            chain = list(reversed(error.args[1]))
            found.append(" -> ".join(chain))
            left[chain[-2]].remove(chain[-1])
        else:
            return found


def test_every_circle_is_found_in_the_order_of_its_imports() -> None:
    found = circles({"a": {"b"}, "b": {"c", "d"}, "c": {"a", "e"}, "d": set(), "e": {"f"}, "f": {"e"}})
    assert len(found) == 2
    assert any(chain in found for chain in ("a -> b -> c -> a", "b -> c -> a -> b", "c -> a -> b -> c"))
    assert any(chain in found for chain in ("e -> f -> e", "f -> e -> f"))


def test_no_modules_import_each_other() -> None:
    files = {
        module_name(path): path for package in (*PACKAGES, "benchmarks", "docs", "tests") for path in modules(package)
    }
    found = circles({name: imported_modules(path, files) for name, path in files.items()})
    assert not found, "circles of imports; move what both ends need to a third module:\n" + "\n".join(found)
