"""All scenarios, by name."""

from scenarios.eraser import Eraser

SCENARIOS = {Eraser.name: Eraser}
"""Scenario classes by the name that the command line uses."""
