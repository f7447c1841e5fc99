"""Files of logs as their makers describe them, without what their contents mean."""
