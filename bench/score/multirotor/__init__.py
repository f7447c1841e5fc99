"""RotorPy's multirotor with hidden effects, its references, and what a log shows of its flights."""
