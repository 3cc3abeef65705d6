"""``python -m truing``: the command line where its program is not on the path."""

import truing.pipeline.__main__  # noqa: F401
