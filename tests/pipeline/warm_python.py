"""A Python process with third-party imports loaded that forks for every call: like a new process, but faster."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import traceback
from pathlib import Path

AVAILABLE = hasattr(os, "fork")
# What most calls import sooner or later, by names that themselves import the rest late.
_THIRD_PARTY = (
    "pandas",
    "pyarrow.compute",
    "pyarrow.dataset",
    "pyarrow.parquet",
    "pydantic.plugin._loader",
    "typer.rich_utils",
    "typer.testing",
)


class WarmPython:
    """Runs `python -m pipeline` of any project; what belongs to the project is imported anew in every call."""

    def __init__(self, folder: Path) -> None:
        self._streams = (folder / "out.txt", folder / "err.txt")
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._server = subprocess.Popen([sys.executable, __file__, *map(str, self._streams)], text=True, **pipes)

    def call(self, words: list[str], cwd: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
        """Run a command line to its end, its standard streams collected."""
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.write(json.dumps([words, str(cwd), environment]) + "\n")
        self._server.stdin.flush()
        code = int(self._server.stdout.readline())
        return subprocess.CompletedProcess(words, code, *(path.read_text() for path in self._streams))

    def close(self) -> None:
        """End the server."""
        self._server.communicate()


def _serve(out: str, err: str) -> None:
    for module in _THIRD_PARTY:
        importlib.import_module(module)
    for line in sys.stdin:
        words, cwd, environment = json.loads(line)
        child = os.fork()
        if child == 0:
            _become_the_command(words, cwd, environment, (out, err))
        _, status = os.waitpid(child, 0)
        sys.stdout.write(f"{os.waitstatus_to_exitcode(status)}\n")
        sys.stdout.flush()


def _become_the_command(words: list[str], cwd: str, environment: dict[str, str], streams: tuple[str, str]) -> None:
    code = 1
    try:
        for number, path in enumerate(streams, start=1):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), number)
        os.chdir(cwd)
        os.environ.clear()
        os.environ.update(environment)
        sys.path[0] = environment["PYTHONPATH"]
        sys.argv = ["truing", *words]
        from truing.pipeline.entry import main

        main()
    except SystemExit as end:
        code = int(end.code or 0)
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    _serve(*sys.argv[1:])
