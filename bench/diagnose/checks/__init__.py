"""Faults of the data, looked for before any physics is blamed: of its `description`, then of its samples."""
