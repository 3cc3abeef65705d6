"""Tests of truing, in folders that mirror the packages."""
