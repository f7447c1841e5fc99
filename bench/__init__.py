"""One run, in the order the data flows: configuration, data, training, evaluation, record, tracking."""

import os

# Matrices are small here: threads that wait for each other make a diagnosis five times slower, and two processes of
# one thread beat one of two. Before numpy and torch are loaded; who sets it has their way.
os.environ.setdefault("OMP_NUM_THREADS", "1")
