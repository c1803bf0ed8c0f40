"""``python -m contactbench.cli``."""

import sys

from contactbench.cli import main

sys.exit(main())
