"""`python -m malus` is `malus`."""

import sys

from malus.cli import main

sys.exit(main())
