#!/usr/bin/env bash
# Publishes the messages of a bag on their topics, at the pace at which they came. Do it without a running machine,
# or in another ROS_DOMAIN_ID: the topics would mix.
#
#   scripts/replay.sh bags/20260131-142501
#   scripts/replay.sh my_bag --rate 4                     four times as fast
#   scripts/replay.sh my_bag --topics /joint_states /tf   only these
#
# Topics that steer a machine (/im/phase, /im/task_status, tokens between nets) are published only if named.
# Exit codes: 0 replayed (Ctrl-C ends it early), 2 bad usage, no such bag or topic.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
if wants_help "$@"; then help; exit 0; fi
im_env
exec "$IM_BRINGUP/replay" "$@"
