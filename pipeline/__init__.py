"""How stages run: campaign folder, order of stages, freshness, artifacts, command line."""
