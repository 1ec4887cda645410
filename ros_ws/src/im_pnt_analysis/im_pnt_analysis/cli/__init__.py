"""The command line ``pnt``, a file for each command."""

from im_pnt.cli.main import main

__all__ = ["main"]
