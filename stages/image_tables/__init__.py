"""Tables for the network from photographs or measured rays, and prior knowledge."""
