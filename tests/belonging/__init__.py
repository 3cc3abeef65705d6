"""Slips of the hand in otherwise good campaigns, made in their files as a person makes them."""
