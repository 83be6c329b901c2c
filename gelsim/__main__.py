"""`python -m gelsim` is `gelsim`."""

import sys

from gelsim.cli import main

sys.exit(main())
