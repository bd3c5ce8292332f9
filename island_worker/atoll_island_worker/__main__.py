"""The entry of the program: the console script, and ``python -m atoll_island_worker``."""

import os
import signal


def main() -> None:
    """Run the program; Ctrl-C ends it without a traceback, as soon as it is here."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # raised within an import it may be lost
        signal.signal(signal.SIGINT, lambda number, frame: os._exit(130))
    try:
        from atoll_core.main_program import run_program

        run_program("atoll_island_worker.cli")
    except KeyboardInterrupt:
        os._exit(130)


if __name__ == "__main__":
    main()
