"""From rays measured elsewhere, and what is known beforehand, to the tables that the network is made of."""
