"""Benchmarks against other libraries in one run; README.md explains the figures and how they are measured."""
