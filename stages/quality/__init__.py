"""Quality checks of a campaign, one by one."""
