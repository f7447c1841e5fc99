"""Terms that no catalogue has: learned from what named effects leave, one or a few functions of measured signals."""
