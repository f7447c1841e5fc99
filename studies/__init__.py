"""The comparisons of the paper, one file each."""
