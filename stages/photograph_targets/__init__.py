"""Photographs opened, and the targets in them measured."""
