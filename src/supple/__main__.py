"""The command ``supple``, and ``python -m supple``."""

import gc
import os


def main() -> None:
    """Run the command line of this process, and exit."""
    try:
        # Most objects of a short command live until it exits: frequent garbage collection takes 5 % of its time.
        gc.set_threshold(200_000, 20, 20)
        # Matrix products here are small, and OpenBLAS's other threads spin for a tenth of a second before they sleep.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        from supple import cli

        cli.main()
    except KeyboardInterrupt:  # of an import
        os.write(2, b"supple: interrupted\n")
        os._exit(130)


if __name__ == "__main__":
    main()
