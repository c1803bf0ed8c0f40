"""``python -m contactbench``."""

import sys

from contactbench.cli import main

sys.exit(main())
