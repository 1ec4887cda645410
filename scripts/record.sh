#!/usr/bin/env bash
# Records topics of the machine into a bag (MCAP, rosbag2 format), also those that appear later, until Ctrl-C.
# rosbag2, Foxglove and PlotJuggler read it.
#
#   scripts/record.sh                                     all topics, into bags/<date>-<time>/
#   scripts/record.sh -o my_bag                           into my_bag/
#   scripts/record.sh --topics /joint_states /pnt/firings /tf
#
# SIGINT (Ctrl-C) and SIGTERM end it properly; a recorder killed otherwise leaves a bag that cannot be read.
# Exit codes: 0 recorded, 2 bad usage or the folder exists.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
if wants_help "$@"; then help; exit 0; fi
im_env
exec "$IM_BRINGUP/record" "$@"
