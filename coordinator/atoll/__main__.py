"""The entry of the program: the console script, and ``python -m atoll``."""

import os


def main() -> None:
    """Run the program; Ctrl-C ends it without a traceback, as soon as it is here."""
    try:
        from atoll_core.program import run_program

        run_program("atoll.cli.main")
    except KeyboardInterrupt:
        os._exit(130)


if __name__ == "__main__":
    main()
