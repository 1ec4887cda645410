#!/usr/bin/env bash
# Calibrates cameras with the light on the arm: the ROS service call /dispatcher/calibrate_camera, with its progress.
# The machine must run (scripts/start.sh).
#
#   scripts/calibrate_camera.sh                              the two ceiling cameras, the cell's own poses
#   scripts/calibrate_camera.sh --cameras ceiling_left       one camera
#   scripts/calibrate_camera.sh --poses my_poses.yaml        other poses of the wrist
#   scripts/calibrate_camera.sh --json > report.json         the report as JSON; progress goes to stderr
#
# Cameras: ceiling_left ceiling_right wall table wrist_left.
# The report, pictures and camera files are in results/<date>-<time>/; results/latest points to the newest.
# Exit codes: 0 done, 1 the command failed (one sentence says why), 2 bad usage, 3 the machine does not run,
# 130 interrupted (Ctrl-C ends the waiting, not the command).
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
if wants_help "$@"; then help; exit 0; fi
im_env
exec "$IM_BRINGUP/calibrate_camera" "$@"
