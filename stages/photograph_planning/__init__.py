"""From a campaign to the network that photographs of it are planned for, and from the plan to tables and sentences."""
