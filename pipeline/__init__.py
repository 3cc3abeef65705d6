"""Execution of stages: campaign folder, order, freshness, artifacts, command line."""
