"""``python -m im_pnt``: the command line ``pnt``."""

import sys

from im_pnt.cli import main

sys.exit(main())
