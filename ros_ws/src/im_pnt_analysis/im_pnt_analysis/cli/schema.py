"""``pnt schema``: the JSON schema of net files."""

import argparse

from im_pnt.cli.exits import OK, Subcommands
from im_pnt.schema import schema_text

_DESCRIPTION = """Prints the JSON schema (draft 2020-12) of YAML net files: editors complete and explain them with it.

Put it beside your nets, and this line on top of each:
  # yaml-language-server: $schema=net.schema.json"""


def add(commands: Subcommands) -> None:
    """Adds the command to the parser."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = commands.add_parser("schema", help="print the JSON schema", description=_DESCRIPTION, formatter_class=raw)
    parser.set_defaults(run=run)


def run(_options: argparse.Namespace) -> int:
    """Prints the schema."""
    print(schema_text(), end="")
    return OK
