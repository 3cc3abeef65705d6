"""Free bodies, without a mechanism."""
