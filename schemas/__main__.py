"""``python -m schemas``: write docs/artifacts.md, docs/reference/campaign-toml.md and docs/glossary.md."""

from pathlib import Path

from truing.schemas.glossary import glossary_page
from truing.schemas.pages import artifacts_page, campaign_page

if __name__ == "__main__":
    Path("docs/artifacts.md").write_text(artifacts_page(), encoding="utf-8")
    Path("docs/reference/campaign-toml.md").write_text(campaign_page(), encoding="utf-8")
    Path("docs/glossary.md").write_text(glossary_page(), encoding="utf-8")
