"""``python -m atoll_coordinator``: the same program as the console script."""

import sys

from atoll_coordinator.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
