"""Faults of the data, looked for before any physics is blamed."""
