#!/usr/bin/env bash
# Everything that is checked, from a clean clone: ruff, mypy --strict, the tests of the packages (no ROS),
# the tests with nodes and processes, and the case study from end to end.
#
#   scripts/test.sh                     all of it
#   scripts/test.sh --quick             without nodes and without the case study
#   scripts/test.sh -k spot             what pytest selects; arguments that are not ours go to pytest
#
# The last line is "N passed, N failed"; ruff, the stubs and mypy count as one each. Exit codes: 0 all passed, 1 not,
# 2 bad usage.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
if wants_help "$@"; then help; exit 0; fi

quick=0
selection=()
for argument in "$@"; do
  if [[ "$argument" == --quick ]]; then quick=1; else selection+=("$argument"); fi
done

"$IM_ROOT/scripts/setup.sh"
# The tests of the page need a browser, which PyPI does not have; without one they are skipped, and say how to get it.
if ((!quick && EUID == 0)) && ! command -v chromium chromium-browser >/dev/null && command -v apt-get >/dev/null; then
  say "test: installing chromium, in which the page is tested"
  { apt-get update -qq && apt-get install -y -qq --no-install-recommends chromium; } >/dev/null ||
    say "test: chromium could not be installed; the tests of the page are skipped"
fi
im_env
export PYTHONPATH="$IM_ROOT:$IM_ROOT/test:$PYTHONPATH"  # bench, and test/support, also for the children of tests
unset PYTHONDONTWRITEBYTECODE  # else each process compiles pytest, hypothesis and what it imports of the tests anew
cd "$IM_ROOT"
# Before minutes of checks: does pytest know the options?
"$IM_VENV/bin/python" -m pytest --markers ${selection[@]+"${selection[@]}"} >/dev/null ||
  die 2 "pytest does not take these arguments"
results="$(mktemp -d)"
trap 'kill "${mypy:-}" 2>/dev/null || true; rm -rf "$results"' EXIT
trap 'exit 130' INT TERM HUP
passed=0 failed=0

# check NAME COMMAND...: one check, one result.
check() {
  local name="$1" began=$SECONDS
  shift
  say "== $name"
  if "$@"; then
    passed=$((passed + 1))
    say "== $name: passed ($((SECONDS - began)) s)"
  else
    failed=$((failed + 1))
    say "== $name: FAILED ($((SECONDS - began)) s)"
  fi
}

# tests NAME ARGS...: pytest, one result a test. Exit code 5 says that nothing was selected.
tests() {
  local name="$1" began=$SECONDS file="$results/${1// /_}.xml" code=0 counts
  shift
  say "== $name tests"
  "$IM_VENV/bin/python" -m pytest -q --junitxml="$file" "$@" ${selection[@]+"${selection[@]}"} || code=$?
  if [[ ! -s "$file" ]]; then
    failed=$((failed + 1))
    say "== $name tests: pytest did not run"
    return
  fi
  read -r -a counts < <("$IM_VENV/bin/python" "$IM_ROOT/scripts/count_tests.py" "$file")
  passed=$((passed + counts[0]))
  failed=$((failed + counts[1]))
  if ((code != 0 && code != 5 && counts[1] == 0)); then failed=$((failed + 1)); fi
  say "== $name tests: ${counts[0]} passed, ${counts[1]} failed ($((SECONDS - began)) s)"
}

# ended PROCESS FILE: the exit code of what runs beside the rest, and what it said.
ended() {
  local code=0
  wait "$1" || code=$?
  cat "$2"
  return "$code"
}

check ruff "$IM_VENV/bin/ruff" check --no-cache ros_ws/src bench test scripts examples
packages=(bench)
for folder in ros_ws/src/*/; do
  name="$(basename "$folder")"
  [[ -f "$folder$name/__init__.py" ]] && packages+=("$folder$name")
done
# What mypy knows of the messages is written from the messages that were built.
rm -rf "$IM_WS/build/stubs"
check "stubs of the messages" "$IM_VENV/bin/python" scripts/message_stubs.py "$IM_WS/build/stubs"
"$IM_VENV/bin/python" -m mypy "${packages[@]}" >"$results/mypy" 2>&1 </dev/null &
mypy=$!
# Halves in their order, of which whoever is done takes from the other: what a file makes once is made once.
tests unit ros_ws/src bench --numprocesses auto --dist worksteal
check mypy ended "$mypy" "$results/mypy"
mypy=""
if ((!quick)); then
  # Three files at a time, the longest first (test/conftest.py): a third of the time they wait.
  # A process that dies ends them: what would begin in its place waits for ever once the others are done.
  tests "node and end-to-end" test --numprocesses 3 --dist loadfile --no-loadscope-reorder --max-worker-restart 0
fi

say ""
say "$passed passed, $failed failed"
((failed == 0))
