"""``python -m fem_snh`` is the program ``fem-snh``."""

import sys

from fem_snh.cli import main

if __name__ == "__main__":
    sys.exit(main())
