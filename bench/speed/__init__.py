"""How fast training is on this machine: beside an unrolled reference, torch's own layers and the products alone."""
