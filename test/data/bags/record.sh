#!/usr/bin/env bash
# Records the missions of this folder anew, after a change of nets or functions that is meant (docs/replay.md): starts a
# machine at clock factor 0, has it run calibrate_camera with the poses of NAME.yaml, keeps in NAME/ what --mission needs
# of the recording, and runs that again.
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
[[ $# -gt 0 ]] || set -- undisturbed faults
for name in "$@"; do
  [[ -f "$here/$name.yaml" ]] || die 2 "there are no poses for a mission $name: $here/$name.yaml"
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
for name in "$@"; do
  "$IM_ROOT/scripts/record.sh" -o "$work/$name" & recorder=$!
  until [[ -d "$work/$name" ]]; do
    kill -0 "$recorder" 2> /dev/null || die 1 "the recorder has ended (what it says is above)"
    sleep 0.2
  done
  "$IM_ROOT/scripts/start.sh" --factor 0 --port "${PORT:-8080}" --timeout 300 --fresh
  cp "$here/$name.yaml" "$work/poses.yaml"  # no path of this computer comes into the bag
  "$IM_ROOT/scripts/calibrate_camera.sh" --poses "$work/poses.yaml"
  "$IM_ROOT/scripts/stop.sh"
  kill -TERM "$recorder"
  wait "$recorder"
  recorder=""
  "$IM_ROOT/scripts/replay.sh" "$work/$name" --extract "$work/small/$name"
  "$IM_ROOT/scripts/replay.sh" "$work/small/$name" --mission
  rm -rf "${here:?}/$name"
  cp -r "$work/small/$name" "$here/$name"
done
