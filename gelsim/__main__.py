"""`python -m gelsim` is `gelsim`."""

import sys

from gelsim.cli.main import main

sys.exit(main())
