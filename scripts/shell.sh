#!/usr/bin/env bash
# Opens a shell with everything sourced: ROS, the workspace, the virtual environment, the ROS domain of this machine.
#
#   scripts/shell.sh                     interactive; leave it with exit
#   scripts/shell.sh COMMAND ARGS...     one command in that environment
#   scripts/shell.sh python -c 'import rclpy, im_msgs.msg'
#
# The folder scripts/ is on its PATH: `im recover` is scripts/im recover. In `im run`, once it has been run, names of
# commands, options and choices are completed.
#
# Exit code: that of the command.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then help; exit 0; fi
im_env
export PATH="$IM_ROOT/scripts:$PATH"
if (($#)); then exec "$@"; fi
say "shell of im: ROS domain $ROS_DOMAIN_ID, run folder $IM_RUN_DIR; leave it with exit"
export IM_PROMPT="(im $ROS_DOMAIN_ID) "
exec bash --rcfile <(printf '%s\n' '[[ -f ~/.bashrc ]] && source ~/.bashrc' "export PATH='$PATH'" "source '$IM_ROOT/scripts/im_completion.bash'" 'PS1="$IM_PROMPT${PS1:-\$ }"') -i
