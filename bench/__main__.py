"""`python -m bench`."""

import os
import sys

if __name__ == "__main__":
    here = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
    if not sys.flags.safe_path and os.path.realpath(sys.path[0]) != here:
        del sys.path[0]  # the working directory: a `numpy.py` among somebody's logs would be run

    from bench.cli import main

    main()
