"""``python -m taichi_dem``: the command line without its script."""

import sys

from taichi_dem.cli import main

sys.exit(main())
