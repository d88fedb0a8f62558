"""The command ``supple``, and ``python -m supple``."""

import gc
import os
from typing import NoReturn


def main() -> NoReturn:
    """Carry out the process's own command line, and end."""
    # Nearly all objects of a short command live to its end: looking for others takes 5 % of its time.
    gc.set_threshold(200_000, 20, 20)
    # No product here is large, and OpenBLAS's other threads spin for a tenth of a second before they sleep.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from supple import cli

    cli.main()


if __name__ == "__main__":
    main()
