"""Moving pictures of a run, rendered without a display."""
