#!/usr/bin/env bash
# Calibrates cameras with the light on the arm: `im run calibrate_camera`, with its progress.
# The machine must run (scripts/start.sh).
#
#   scripts/calibrate_camera.sh                              the two ceiling cameras, the cell's own poses
#   scripts/calibrate_camera.sh --cameras ceiling_left       one camera
#   scripts/calibrate_camera.sh --poses my_poses.yaml        other poses of the wrist
#   scripts/calibrate_camera.sh --target board           by a chessboard on the arm, in place of its light
#   scripts/calibrate_camera.sh --accuracy 0.3mm             until that error is expected, by the poses that tell most
#   scripts/calibrate_camera.sh --json > report.json         the report as JSON; progress goes to stderr
#
# Cameras: ceiling_left ceiling_right wall table wrist_left.
# The report, pictures and camera files are in results/<date>-<time>/; results/latest points to the newest.
# Where a calibration is under way already, it says its number, and asks whether to attach to it.
# Exit codes: 0 done, 1 the command failed (one sentence says why), 2 bad usage, 3 the machine does not run,
# 130 interrupted (Ctrl-C cancels the command and waits for its end).
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
[[ " $* " == *" --json "* ]] || keep_interrupts "$@"
if wants_help "$@"; then help; exit 0; fi

given=() json=0
while (($#)); do
  case "$1" in
    --cameras)
      [[ $# -gt 1 && "$2" != -* ]] || die 2 "--cameras: expected at least one argument"
      given+=(--cameras)
      shift
      while (($#)) && [[ "$1" != -* ]]; do given+=("$1"); shift; done
      ;;
    --poses)
      [[ $# -gt 1 ]] || die 2 "--poses: expected one argument"
      given+=(--poses-file "$(realpath -m -- "$2")")
      shift 2
      ;;
    --accuracy | --target)
      [[ $# -gt 1 ]] || die 2 "$1: expected one argument"
      given+=("$1" "$2")
      shift 2
      ;;
    --json) json=1; shift ;;
    *) die 2 "there is no $1; there are --cameras, --poses, --target, --accuracy and --json" ;;
  esac
done
im_env
if ((!json)); then exec "$IM_BRINGUP/run" im_bringup run_command calibrate_camera ${given[@]+"${given[@]}"}; fi
code=0
results="$(env --block-signal=INT "$IM_BRINGUP/run" im_bringup run_command calibrate_camera --json ${given[@]+"${given[@]}"})" || code=$?
((code == 0)) || exit "$code"
"$IM_VENV/bin/python" -c 'import json, sys; print(json.dumps(json.load(sys.stdin)["report"], indent=2))' <<<"$results"
