#!/usr/bin/env bash
# Runs an executable of the workspace with everything sourced.
#
#   scripts/run.sh                                        lists packages and their executables
#   scripts/run.sh PACKAGE                                lists the executables of one package
#   scripts/run.sh PACKAGE EXECUTABLE ARGS...             runs it
#   scripts/run.sh im_dom dom --ros-args -p standalone:=true
#   scripts/run.sh im_pnt_analysis pnt verify ros_ws/src/im_dispatcher/im_dispatcher/nets/*.yaml
#
# Exit codes: that of the executable; 2 if there is no such package or executable (said which there are).
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
keep_interrupts "$@"
if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then help; exit 0; fi
im_env
exec "$IM_BRINGUP/run" "$@"
