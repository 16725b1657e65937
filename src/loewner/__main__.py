"""`python -m loewner` is the command line."""

import sys

from loewner.cli import main

sys.exit(main())
