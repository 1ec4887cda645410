#!/usr/bin/env bash
# Starts the machine of this ROS domain and returns when every task is ready; else says which is not, and why.
#
#   scripts/start.sh                             the default deployment, in real time
#   scripts/start.sh my_deployment.yaml          another one
#   scripts/start.sh --factor 0 --seed 7         simulated time as fast as it goes, another seed
#   scripts/start.sh --factor 0.5                half as fast as real time, for a computer that is slow or busy
#   scripts/start.sh --perfect-arm               the simulated arms as drawn; else the tool is off by 0.3 to 1 mm
#   scripts/start.sh --port 8081                 another port for the display (a web page); the next free one if in use
#   scripts/start.sh --control                   the page may also operate the machine: commands, nets, stops
#   scripts/start.sh --foxglove                  Foxglove may connect, to ws://localhost:8765 or another port
#   scripts/start.sh --unproved                  even where nobody can tell in time whether its nets may run together
#   scripts/start.sh --resume                    commands that had not ended go on; without it they come back paused
#   scripts/start.sh --fresh                     set unfinished commands of a former run aside
#   scripts/start.sh --timeout 120               a longer wait, of its parts for each other too (default 60 s)
#   scripts/start.sh --foreground                stays until the machine ends; Ctrl-C stops it
#   scripts/start.sh --calibration results/latest   cameras (and laser scanner) as calibrated before, not as drawn
#
# A second machine on this host needs another ROS_DOMAIN_ID, and another --port:
#   ROS_DOMAIN_ID=7 scripts/start.sh --port 8081
#
# Other hosts reach nothing of it, unless the deployment has tasks on several hosts (docs/security.md).
#
# Logs: .run/im<domain>/log/<process>.log. Stop it with scripts/stop.sh.
# Exit codes: 0 ready, or with --foreground stopped; 1 not started (said why; nothing is left running), or ended by
# itself; 2 bad usage, deployment or calibration; 130 interrupted before it was ready.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
keep_interrupts "$@"
if wants_help "$@"; then help; exit 0; fi
im_env
exec "$IM_BRINGUP/run" im_bringup start "$@"
