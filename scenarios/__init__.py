"""Scenarios: plants, runs, and the command line."""
