"""How many threads numpy and torch compute with."""

import os


def one_thread_by_default() -> None:
    """One thread in this process and those that it starts, unless OMP_NUM_THREADS says otherwise.

    Call it before numpy and torch are loaded. Matrices are small here: threads that wait for each other make a
    diagnosis five times slower, and two processes of one thread beat one of two.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
