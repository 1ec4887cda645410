"""``pnt schema``: the JSON schema of net files."""

import argparse

from im_pnt.netfile import schema_text
from im_pnt_analysis.cli.terminal import OK

_DESCRIPTION = """Prints the JSON schema (draft 2020-12) of YAML net files: editors complete and explain them with it.

Put it beside your nets, and this line on top of each:
  # yaml-language-server: $schema=net.schema.json"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)


def run(_options: argparse.Namespace) -> int:
    """Print the schema."""
    print(schema_text(), end="")
    return OK
