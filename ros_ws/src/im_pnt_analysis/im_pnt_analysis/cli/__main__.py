"""``python -m im_pnt_analysis.cli``: the command line ``pnt``."""

import sys

from im_pnt_analysis.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
