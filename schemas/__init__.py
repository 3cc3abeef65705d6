"""What campaign.toml and every artifact hold: columns, types, units, bounds, meaning."""
