"""Let the diagnosis of a campaign search few causes, where a test asks something else of its run."""

from __future__ import annotations

from pathlib import Path

from truing.pipeline.campaign_folder import open_campaign
from truing.stages.diagnosis.search import kinds_of


def search_only(campaign: Path, *kept: str) -> Path:
    """Have ``[diagnosis] ignore`` name every cause of the catalogue but those that are kept; return the campaign.

    Effects without a name are searched as before: they cannot be ignored.
    """
    kinds = kinds_of(open_campaign(campaign).validated())
    ignored = [name for name, cause in kinds.items() if cause.catalogued and name not in kept]
    assert len(ignored) + len(kept) == sum(cause.catalogued for cause in kinds.values()), kept
    file = campaign / "campaign.toml"
    text = file.read_text(encoding="utf-8")
    assert "[diagnosis]" not in text
    file.write_text(f"{text}\n[diagnosis]\nignore = {ignored}\n".replace("'", '"'), encoding="utf-8")
    return campaign
