"""`python -m prtcl` is the command line."""

import sys

from prtcl.apps.cli import main

sys.exit(main())
