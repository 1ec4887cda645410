#!/usr/bin/env bash
# Stops the machine of this ROS domain, the last started task first, in 5 s or less; also removes what a killed machine
# left in the process table and in /dev/shm. Other machines (another ROS_DOMAIN_ID) are not touched.
#
#   scripts/stop.sh
#   ROS_DOMAIN_ID=7 scripts/stop.sh
#
# Exit codes: 0 nothing runs any more, 1 something could not be ended (said what), 2 bad usage.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
keep_interrupts "$@"
if wants_help "$@"; then help; exit 0; fi
im_env
exec "$IM_BRINGUP/run" im_bringup stop "$@"
