#!/usr/bin/env bash
# Tells what a bag holds: its topics, the time line of the mission (which transition fired when, for how long, after
# what), events that were not recorded, and how long each action took beside what its net expects.
#
#   scripts/bag_report.sh bags/demo
#   scripts/bag_report.sh bags/demo --all                     every line of every table, topics without messages too
#   scripts/bag_report.sh bags/demo --picture mission.svg     the time line drawn, .svg or .png
#
# A bag whose recorder was killed is completed before. No machine is needed.
# Exit codes: 0 told, 2 bad usage, no such bag, nothing has fired in it.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
keep_interrupts "$@"
if wants_help "$@"; then help; exit 0; fi
im_env
exec "$IM_ROOT/scripts/im" pnt bag "$@"
