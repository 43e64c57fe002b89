"""`python -m cablejax.cli`, the same as `cablejax`."""

import sys

from cablejax.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
