"""Run the program ``fem-snh`` as ``python -m fem_snh``."""

import sys

from fem_snh.cli import main

if __name__ == "__main__":
    sys.exit(main())
