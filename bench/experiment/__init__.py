"""What is run: a configuration in the paper's notation, its key and seeds, and the studies that compare several."""
