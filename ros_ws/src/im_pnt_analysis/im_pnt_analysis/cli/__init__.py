"""The command line ``pnt``, a file for each command."""

from im_pnt_analysis.cli.main import main

__all__ = ["main"]
