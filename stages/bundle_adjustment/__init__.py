"""From tables of rays to an adjusted network, and from that to tables."""
