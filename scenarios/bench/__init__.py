"""Where the time of a control tick goes: measured side by side, in one run, on one core."""
