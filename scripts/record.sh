#!/usr/bin/env bash
# Records topics of the machine into a bag (MCAP, rosbag2 format), also those that appear later, until Ctrl-C.
# rosbag2, Foxglove and PlotJuggler read it (docs/replay.md).
#
#   scripts/record.sh                                     all topics, into bags/<date>-<time>/
#   scripts/record.sh -o my_bag                           into my_bag/
#   scripts/record.sh --topics /joint_states /pnt/firings /tf
#
# A bag consists of parts of at most 256 MiB or 5 minutes; each can be read when the next has begun. SIGINT (Ctrl-C) and
# SIGTERM end the recording properly; a recorder killed otherwise loses its last second, and whatever reads the bag next
# completes it. It ends by itself, with all that was written, before less than 64 MiB of the disk are free.
# Exit codes: 0 recorded, 1 the disk is full or nearly so (said), 2 bad usage or the folder exists.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
keep_interrupts "$@"
if wants_help "$@"; then help; exit 0; fi
im_env
exec "$IM_BRINGUP/run" im_bag record "$@"
