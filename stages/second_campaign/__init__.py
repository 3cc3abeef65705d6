"""A second campaign of the same machine: what models that were fitted to the first one predict of it."""
