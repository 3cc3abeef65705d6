"""Conversions that several stages use: tables to arrays and back, and settings of campaign.toml in SI."""
