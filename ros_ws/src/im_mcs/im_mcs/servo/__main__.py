"""``python -m im_mcs.servo INSTANCE [CONFIG [PRESET [PERIOD [SAMPLE_RATE]]]]``: the servo process of one machine."""

import sys
from pathlib import Path

from im_core.errors import ImError
from im_mcs.limits.configuration import load_config
from im_mcs.servo.process import run


def main(arguments: list[str]) -> int:
    """Run the servo; return 1 if the servo cannot be started, with the reason on standard error."""
    try:
        config = load_config(Path(arguments[1]) if len(arguments) > 1 and arguments[1] else None)
        if len(arguments) > 2:
            config = config.with_preset(arguments[2])
        if len(arguments) > 3:
            config = config.at_period(float(arguments[3]))
        if len(arguments) > 4:
            config = config.at_sample_rate(float(arguments[4]))
        return run(arguments[0], config)
    except ImError as error:
        print(error.message, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
