"""A second campaign of the same machine, predicted by models fitted to the first one."""
