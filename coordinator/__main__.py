"""``python -m coordinator``: the same program as the console script."""

import sys

from coordinator.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
