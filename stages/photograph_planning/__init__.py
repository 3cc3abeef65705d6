"""Planning of photographs: the network of a campaign, and the plan as tables and sentences."""
