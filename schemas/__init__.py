"""Definitions of campaign.toml and of every artifact: columns, types, units, bounds, meaning."""
