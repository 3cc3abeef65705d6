"""``python -m schemas``: write docs/artifacts.md and docs/reference/campaign-toml.md anew."""

from pathlib import Path

from truing.schemas.pages import artifacts_page, campaign_page

if __name__ == "__main__":
    Path("docs/artifacts.md").write_text(artifacts_page(), encoding="utf-8")
    Path("docs/reference/campaign-toml.md").write_text(campaign_page(), encoding="utf-8")
