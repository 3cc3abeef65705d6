"""The checks of a campaign's quality, one by one."""
