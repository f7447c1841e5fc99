"""Physical effects that a simple model leaves out: one effect a class."""
