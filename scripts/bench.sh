#!/usr/bin/env bash
# Measures the machine: start, stop, the calibrate_camera command, memory, the servo. Absolute figures depend on the
# computer and on what else it does; each is therefore also given as a ratio to a baseline measured in the same run.
#
#   scripts/bench.sh                    simulated time as fast as it goes, two commands
#   scripts/bench.sh --real-time        and one command in real time, for the servo's period and missed deadlines
#   scripts/bench.sh --runs 5           five commands in a row: does memory grow?
#   scripts/bench.sh --seeds 10         instead: true errors over expected ones, over ten seeds
#
# The figures are also in results/bench-<date>-<time>.json.
# Exit codes: 0 all bars are met, 1 a bar is missed or the machine did not work, 2 bad usage, 130 interrupted.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
if wants_help "$@"; then help; exit 0; fi
"$IM_ROOT/scripts/setup.sh"
im_env
exec "$IM_BRINGUP/bench" "$@"
