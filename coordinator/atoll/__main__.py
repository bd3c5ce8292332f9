"""The entry of the program: the console script, and ``python -m atoll``."""

import os
import signal


def main() -> None:
    """Run the program; from here on, Ctrl-C ends it without a traceback."""
    if (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler
    ):  # an exception raised during an import may be lost
        signal.signal(signal.SIGINT, lambda number, frame: os._exit(130))
    try:
        from atoll_core.main_program import run_program

        run_program("atoll.cli.main")
    except KeyboardInterrupt:
        os._exit(130)


if __name__ == "__main__":
    main()
