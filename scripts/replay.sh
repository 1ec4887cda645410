#!/usr/bin/env bash
# Publishes the messages of a bag on their topics, at the pace at which they came. Where a machine runs in this
# ROS_DOMAIN_ID, on whatever host, it refuses: the topics would mix. With --recalibrate it publishes nothing: it computes
# a calibration of the bag again, and puts it beside the recorded one.
#
#   scripts/replay.sh bags/20260131-142501
#   scripts/replay.sh my_bag --rate 4                     four times as fast
#   scripts/replay.sh my_bag --topics /joint_states /tf   only these
#   scripts/replay.sh my_bag --start 90 --loop --paused   from the 90th second on, again and again; space begins
#   scripts/replay.sh my_bag --remap /tf:=/old/tf --clock under another name; the time of the bag on /clock
#   scripts/replay.sh my_bag --force                      even onto the topics of a running machine
#   scripts/replay.sh my_bag --recalibrate                the calibration again, from the recorded spots
#   scripts/replay.sh my_bag --recalibrate --from images  from the recorded images: the spots are found again
#   scripts/replay.sh my_bag --recalibrate --cameras ceiling_left --lens-model equidistant -o mine   a new one
#   scripts/replay.sh --recalibrate --help                its options
#   scripts/replay.sh my_bag --mission                    runs its nets again, without a machine: do they do the same?
#   scripts/replay.sh my_bag --extract small_bag          only what --mission needs, into a small bag
#   scripts/replay.sh my_bag --display                    its nets on a web page, with a time line to scroll in
#
# --display publishes nothing: http://localhost:8080 (--port, --host) shows each moment, without a machine.
# --mission compares firing by firing, and tells the first difference with both sides; --mission --help has its options.
# Keys: space pauses and goes on, . steps to the next message, left and right seek by 5 s, q ends it. What was latched
# before the place where it begins is published first. A bag whose recorder was killed is completed before. Topics that
# steer a machine (/im/phase, /im/task_status, tokens between nets, /left/joint_trajectory, /left/command/setpoints) and
# the events of services are published only if they are named.
# Exit codes: 0 replayed (Ctrl-C ends it early), 2 bad usage, no such bag or topic, a type that has changed, a machine
# runs here; with --recalibrate also 1: not the same numbers though nothing was changed, or a verdict against the new
# ones; with --mission: 0 equal, 1 it differs, 2 the bag cannot be run again.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
keep_interrupts "$@"
doing=""
rest=()
for argument in "$@"; do
  case "$argument" in
    --display | --mission | --recalibrate)
      [[ -z "$doing" || "$doing" == "$argument" ]] || die 2 "$doing and $argument are two things to do with a bag; name one"
      doing="$argument"
      ;;
    *) rest+=("$argument") ;;
  esac
done
if [[ -z "$doing" ]] && wants_help "$@"; then help; exit 0; fi
im_env
set -- ${rest[@]+"${rest[@]}"}
case "$doing" in
  --display) exec "$IM_ROOT/scripts/im" pnt display "$@" ;;
  --mission) exec "$IM_ROOT/scripts/im" pnt mission "$@" ;;
  --recalibrate) exec "$IM_BRINGUP/run" im_vss recalibrate --recalibrate "$@" ;;
esac
exec "$IM_BRINGUP/run" im_bag replay "$@"
