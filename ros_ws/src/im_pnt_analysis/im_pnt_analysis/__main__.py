"""``python -m im_pnt_analysis``: the command line ``pnt``."""

import sys

from im_pnt_analysis.cli import main

sys.exit(main())
