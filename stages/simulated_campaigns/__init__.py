"""Simulated campaigns with a campaign's layout, and the effects found in them."""
