"""Campaigns drawn again from a campaign's own layout, and what was found in them."""
