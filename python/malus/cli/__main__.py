"""`python -m malus.cli` runs the command line `malus`."""

import sys

from malus.cli import main

sys.exit(main())
