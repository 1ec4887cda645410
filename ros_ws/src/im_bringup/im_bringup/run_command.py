"""``run PACKAGE EXECUTABLE ARGS...``: replace this process by an executable of the workspace."""

import os
import sys

from im_bringup.executables import executables, packages, path_of
from im_core.errors import NotFoundError


def main() -> int:
    """Run it; with less than two arguments, list what there is.

    Returns:
        0 after a listing, 2 if there is no such thing; does not return otherwise.
    """
    arguments = sys.argv[1:]
    try:
        if not arguments:
            for package in packages():
                print(f"{package}: {' '.join(executables(package))}")
        elif len(arguments) == 1 or arguments[1] in ("-h", "--help"):
            print("\n".join(executables(arguments[0])))
        else:
            path = path_of(arguments[0], arguments[1])
            os.execv(path, [str(path), *arguments[2:]])
    except NotFoundError as error:
        print(f"run: {error.message}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
