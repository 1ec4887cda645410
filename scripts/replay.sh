#!/usr/bin/env bash
# Publishes the messages of a bag on their topics, at the pace at which they came. Do it without a running machine,
# or in another ROS_DOMAIN_ID: the topics would mix.
#
#   scripts/replay.sh bags/20260131-142501
#   scripts/replay.sh my_bag --rate 4                     four times as fast
#   scripts/replay.sh my_bag --topics /joint_states /tf   only these
#   scripts/replay.sh my_bag --start 90 --loop --paused   from the 90th second on, again and again; space begins
#   scripts/replay.sh my_bag --remap /tf:=/old/tf --clock under another name; the time of the bag on /clock
#
# Keys: space pauses and goes on, . steps to the next message, left and right seek by 5 s, q ends it. What was latched
# before the place where it begins is published first. A bag whose recorder was killed is completed before. Topics that
# steer a machine (/im/phase, /im/task_status, tokens between nets) and the events of services are published only if
# they are named.
# Exit codes: 0 replayed (Ctrl-C ends it early), 2 bad usage, no such bag or topic, a type that has changed.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
if wants_help "$@"; then help; exit 0; fi
im_env
exec "$IM_BRINGUP/replay" "$@"
