"""`python -m cablejax.cli`, the same as `cablejax`."""

import sys

from cablejax.cli.main import main

sys.exit(main())
