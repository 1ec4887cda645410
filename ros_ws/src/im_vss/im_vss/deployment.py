"""``python -m im_vss.deployment``: print the part of a deployment file for some Services."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from im_cell.robot import load_cell
from im_core.errors import ImError
from im_core.text.yamltext import write_yaml
from im_vss.catalogue import load_catalogue
from im_vss.settings import load_settings


def main(arguments: Sequence[str] | None = None) -> int:
    """Print hosts, processes and tasks as YAML; exit code 1 with one sentence if a Service does not exist."""
    parser = argparse.ArgumentParser(prog="python -m im_vss.deployment", description=__doc__)
    parser.add_argument("services", nargs="*", help="Services in use; those of vss.yaml by default")
    parser.add_argument("--catalogue", type=Path, default=None, help="a catalogue.yaml; the shipped one by default")
    options = parser.parse_args(arguments)
    try:
        services = options.services or load_settings(load_cell()).services
        hosts = load_catalogue(options.catalogue).closure(services).deployment(options.catalogue)
    except ImError as error:
        print(f"{parser.prog}: {error.message}", file=sys.stderr)
        return 1
    print(write_yaml({"hosts": hosts}), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
