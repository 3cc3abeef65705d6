"""``python -m schemas``: write docs/artifacts.md anew."""

from pathlib import Path

from schemas.page import artifacts_page

if __name__ == "__main__":
    Path("docs/artifacts.md").write_text(artifacts_page(), encoding="utf-8")
