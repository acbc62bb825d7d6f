"""Where text for a person goes."""

import sys

from rich.console import Console


def console() -> Console:
    """Return the console of standard output: as wide as the terminal, or 120 columns."""
    width = None if sys.stdout.isatty() else 120
    return Console(width=width, highlight=False)
