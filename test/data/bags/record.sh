#!/usr/bin/env bash
# Records the missions of this folder anew, after a change of nets or functions that is meant (docs/replay.md): starts a
# machine at clock factor 0, has it run calibrate_camera with the poses of NAME.yaml, keeps in NAME/ what --mission needs
# of the recording, and runs that again. Two have the poses of undisturbed.yaml: of "cancelled" the command is cancelled
# after its second pose; of "killed" the Vision Coordinator, in a process of its own, is killed there (kill -9).
#
#   test/data/bags/record.sh                     all of them
#   test/data/bags/record.sh faults              only these
#   ROS_DOMAIN_ID=7 PORT=8087 test/data/bags/record.sh    beside another machine
#
# Exit codes: 0 recorded and equal, else that of the first step that failed; the old bag is then still there.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/../../../scripts/lib.sh"
if wants_help "$@"; then help; exit 0; fi
here="$IM_ROOT/test/data/bags"
[[ $# -gt 0 ]] || set -- undisturbed faults cancelled killed

# poses_of NAME: the poses of a mission
poses_of() {
  case "$1" in
    cancelled | killed) echo "$here/undisturbed.yaml" ;;
    *) echo "$here/$1.yaml" ;;
  esac
}
for name in "$@"; do
  [[ -f "$(poses_of "$name")" ]] || die 2 "there are no poses for a mission $name: $(poses_of "$name")"
done
export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
work="$(mktemp -d)"
export IM_RUN_DIR="$work/run" IM_RESULTS_DIR="$work/results"
recorder=""
cleanup() {
  "$IM_ROOT/scripts/stop.sh" > "$work/stop.log" 2>&1 || cat "$work/stop.log" >&2
  [[ -z "$recorder" ]] || kill -TERM "$recorder" 2> /dev/null || true
  rm -rf "$work"
}
trap cleanup EXIT

# processes_of TASK: those of this machine that have the name of a task, of which the kernel keeps fifteen letters
processes_of() {
  local process
  for process in $(pgrep -x "${1:0:15}"); do
    if grep -qzx "IM_RUN_DIR=$IM_RUN_DIR" "/proc/$process/environ" 2> /dev/null; then echo "$process"; fi
  done
}

# calibrate NAME: the command, and what disturbs it
calibrate() {
  cp "$(poses_of "$1")" "$work/poses.yaml"  # no path of this computer comes into the bag
  if [[ "$1" != cancelled && "$1" != killed ]]; then
    "$IM_ROOT/scripts/calibrate_camera.sh" --poses "$work/poses.yaml"
    return
  fi
  "$IM_ROOT/scripts/calibrate_camera.sh" --poses "$work/poses.yaml" > "$work/told" 2>&1 & local command=$!
  until grep -q "pose 2 of" "$work/told"; do
    kill -0 "$command" 2> /dev/null || { cat "$work/told" >&2; die 1 "the command has ended before its third pose"; }
    sleep 0.05
  done
  if [[ "$1" == cancelled ]]; then
    "$IM_ROOT/scripts/im" run --cancel 1
    if wait "$command"; then die 1 "the command has ended before it was cancelled"; fi
  else
    kill -KILL $(processes_of vision_coordinator)
    wait "$command" || true
  fi
  cat "$work/told"
}

for name in "$@"; do
  IM_RUN_DIR="$work/run-$name"  # commands of each machine are numbered from 1
  "$IM_ROOT/scripts/record.sh" -o "$work/$name" & recorder=$!
  until [[ -d "$work/$name" ]]; do
    kill -0 "$recorder" 2> /dev/null || die 1 "the recorder has ended (what it says is above)"
    sleep 0.2
  done
  deployment=default
  [[ "$name" != killed ]] || deployment=each
  "$IM_ROOT/scripts/start.sh" "$IM_ROOT/ros_ws/src/im_bringup/im_bringup/deployments/$deployment.yaml" \
    --factor 0 --port "${PORT:-8080}" --timeout 300 --fresh
  calibrate "$name"
  "$IM_ROOT/scripts/stop.sh"
  kill -TERM "$recorder"
  wait "$recorder"
  recorder=""
  "$IM_ROOT/scripts/replay.sh" "$work/$name" --extract "$work/small/$name"
  "$IM_ROOT/scripts/replay.sh" "$work/small/$name" --mission
  rm -rf "${here:?}/$name"
  cp -r "$work/small/$name" "$here/$name"
done
