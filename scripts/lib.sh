# Shared by all scripts: where things are, how to speak, and the environment of the machine. Source it, do not run it.
# shellcheck shell=bash

IM_ROOT="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
IM_VENV="$IM_ROOT/.venv"
IM_WS="$IM_ROOT/ros_ws"
# Executables of im_bringup.
IM_BRINGUP="$IM_WS/install/im_bringup/lib/im_bringup"
# Recorder and replay of im_bag.
IM_BAG="$IM_WS/install/im_bag/lib/im_bag"
export IM_ROOT

say() { printf '%s\n' "$*"; }
warn() { printf '%s\n' "$*" >&2; }

# die CODE SENTENCE: says what is wrong and ends the script.
die() {
  local code="$1"
  shift
  printf '%s: %s\n' "$(basename "$0" .sh)" "$*" >&2
  exit "$code"
}

# keep_interrupts ARGS...: Ctrl-C waits in the kernel until the program takes it (im_core/executables.py), which begins
# with "$IM_BRINGUP/run": no Python on the way prints a traceback. Begins the calling script anew, with its ARGS.
keep_interrupts() {
  [[ -n "${IM_KEPT:-}" ]] || exec env --block-signal=INT IM_KEPT=1 bash "$0" "$@"
  unset IM_KEPT
}

# help: prints the comment block at the top of the calling script.
help() { sed -n '2,/^[^#]/{s/^# \{0,1\}//;t print;b;: print;p}' "$0"; }

# wants_help ARGS...: true if one of the arguments asks for help.
wants_help() {
  local argument
  for argument in "$@"; do
    [[ "$argument" == -h || "$argument" == --help ]] && return 0
  done
  return 1
}

# is_ros PREFIX: whether it is a ROS installation; an environment made of wheels, this clone's or another's, is none.
is_ros() { [[ -d "$1/share/rclpy" && ! -f "$1/pyvenv.cfg" ]]; }

# True where a ROS 2 Jazzy installation is sourced; it is then the underlay, and the virtual environment adds the rest.
ros_is_sourced() {
  [[ "${ROS_DISTRO:-}" == jazzy && "${IM_WHEELS:-}" != 1 ]] || return 1
  local prefix prefixes
  IFS=: read -r -a prefixes <<<"${AMENT_PREFIX_PATH:-}"
  for prefix in ${prefixes[@]+"${prefixes[@]}"}; do
    is_ros "$prefix" && return 0
  done
  return 1
}

# leave_ros: takes a ROS installation that happens to be sourced out of the environment, but for its programs: Python
# would find its modules before those of the wheels.
leave_ros() {
  local prefix prefixes variable entry entries kept
  IFS=: read -r -a prefixes <<<"${AMENT_PREFIX_PATH:-}"
  for prefix in ${prefixes[@]+"${prefixes[@]}"}; do
    is_ros "$prefix" || continue
    for variable in AMENT_PREFIX_PATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH; do
      [[ -n "${!variable:-}" ]] || continue
      kept=""
      IFS=: read -r -a entries <<<"${!variable}"
      for entry in "${entries[@]}"; do
        [[ "$entry" == "$prefix" || "$entry" == "$prefix"/* ]] || kept+="${kept:+:}$entry"
      done
      export "$variable=$kept"
    done
  done
}

# The Fast DDS profile (quick discovery, the loopback alone) and the defaults of every process.
im_defaults() {
  local name value
  if [[ -z "${HOME:-}" ]]; then
    export HOME="$IM_ROOT/.run"
    mkdir -p "$HOME"
  fi
  export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
  # ROS reads a number, and names of files have its text: 7 and 007 would be two machines in one domain.
  [[ "$ROS_DOMAIN_ID" =~ ^(0|[1-9][0-9]{0,2})$ ]] && ((ROS_DOMAIN_ID <= 232)) ||
    die 2 "ROS_DOMAIN_ID='$ROS_DOMAIN_ID' is no ROS domain: a number from 0 to 232, without zeros before it"
  export IM_RUN_DIR="${IM_RUN_DIR:-$IM_ROOT/.run/im$ROS_DOMAIN_ID}"
  export IM_RESULTS_DIR="${IM_RESULTS_DIR:-$IM_ROOT/results}"
  export ROS_LOG_DIR="${ROS_LOG_DIR:-$IM_RUN_DIR/ros}"
  # For this user alone from the first: ROS, which makes the folder of logs in it, would leave it open to others.
  mkdir -p -m 700 "$IM_RUN_DIR" 2>/dev/null || true
  # The memory policy of our profile counts with the second variable; a profile of the user's may be silent about it.
  [[ -n "${FASTRTPS_DEFAULT_PROFILES_FILE:-}" ]] || export RMW_FASTRTPS_USE_QOS_FROM_XML=1
  export FASTRTPS_DEFAULT_PROFILES_FILE="${FASTRTPS_DEFAULT_PROFILES_FILE:-$IM_WS/src/im_bringup/im_bringup/config/fastdds.xml}"
  while IFS='=' read -r name value; do
    [[ "$name" == "#"* || -n "${!name:-}" ]] || export "$name=$value"
  done <"$IM_WS/src/im_bringup/im_bringup/config/environment.txt"
}

# workspace_files ACTION...: what the workspace is built of, for find. Python files need no build: they are linked.
workspace_files() {
  find "$IM_WS/src" "$IM_WS/standard_msgs" \( -name package.xml -o -name CMakeLists.txt -o -name setup.py -o -name setup.cfg \
    -o -name '*.pyx' -o -name '*.msg' -o -name '*.srv' -o -name '*.action' -o -path '*/launch/*' \) -type f "$@"
}

# im_env: the complete environment, as every script but setup.sh needs it.
im_env() {
  [[ -f "$IM_WS/install/.im-built" && -f "$IM_VENV/.im-installed" ]] ||
    die 3 "the workspace is not built yet; run scripts/setup.sh first"
  # Programs begin with the path of a Python: those of a copy would run what the first clone has.
  local venv
  read -r _ venv <"$IM_VENV/.im-installed"
  [[ "$venv" -ef "$IM_VENV" ]] ||
    die 3 "$IM_ROOT was moved, or copied, since it was set up; run scripts/setup.sh first"
  local changed
  changed="$(workspace_files -newer "$IM_WS/install/.im-built" -print -quit)"
  [[ -z "$changed" ]] ||
    warn "$(basename "$0" .sh): ${changed#"$IM_ROOT"/} is newer than what was built of it; scripts/setup.sh builds it"
  im_defaults
  if [[ -f "$IM_VENV/local_setup.bash" ]]; then leave_ros; fi  # it was set up with wheels
  local nounset=0
  [[ $- == *u* ]] && nounset=1
  set +u
  # shellcheck disable=SC1091
  source "$IM_WS/install/setup.bash"
  ((nounset)) && set -u
  export PATH="$IM_VENV/bin:$PATH" VIRTUAL_ENV="$IM_VENV"
}
