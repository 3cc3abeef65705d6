"""What stages know of a loaded sensor: its readings as arrays, and the sensor that campaign.toml describes."""
