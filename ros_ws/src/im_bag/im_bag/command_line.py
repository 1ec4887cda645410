"""Command line of the programs for one bag."""

import argparse
from collections.abc import Sequence


def parsed(parser: argparse.ArgumentParser, words: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the options of a command line; the usage error for a second bag explains how to handle two bags.

    Args:
        parser: What reads it; its argument ``bag``, where a command has one, is the bag.
        words: The command line without the program's name; None: that of the process.
    """
    options, more = parser.parse_known_args(words)
    if more and getattr(options, "bag", None) is not None and not any(word.startswith("-") for word in more):
        parser.error(f"two bags are given, {options.bag} and {more[0]}; run the command once for each")
    if more:
        parser.error(f"unrecognized arguments: {' '.join(more)}")
    return options
