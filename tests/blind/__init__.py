"""Campaigns with something hidden in them, and the demand that it be found and named."""
