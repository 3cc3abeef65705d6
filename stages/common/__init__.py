"""What several stages need: tables as arrays, arrays as tables, and what campaign.toml declares as values in SI."""
