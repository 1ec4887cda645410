#!/usr/bin/env bash
# Measures the machine: start, stop, the calibrate_camera command, memory, the servo. Absolute figures depend on the
# computer and on what else it does; each is therefore also given as a ratio to a baseline measured in the same run.
#
#   scripts/bench.sh                    simulated time as fast as it goes, two commands
#   scripts/bench.sh --real-time        and one command in real time, for the servo's period and missed deadlines
#   scripts/bench.sh --runs 5           five commands in a row: does memory grow?
#   scripts/bench.sh --seeds 10         instead: true errors over expected ones, over ten seeds
#   scripts/bench.sh --nets             instead: the nets: firings, search, remote tokens, journal; against peers
#   scripts/bench.sh --nets remote      only that; --nets --help tells what there is
#   scripts/bench.sh --mcs              instead: motion control: tracking, lines, the tick, deadlines, lockstep
#   scripts/bench.sh --mcs tick line    only those; --mcs --help tells what there is
#   scripts/bench.sh --vss              instead: vision: frames and answers a second, and where the time goes
#   scripts/bench.sh --vss frames       only that; --vss --help tells what there is
#   scripts/bench.sh --dom              instead: data objects: puts and gets beside a bare service; 200 kills of the store
#   scripts/bench.sh --soak             instead: does anything grow? 200 calibrations in a row; --soak --runs 20: fewer
#   scripts/bench.sh --soak --minutes 60   and with random commands in real time, for an hour
#
# The peers (SNAKES, libpetri, pm4py) are installed once, from bench/peers/requirements.txt into .venv-peers, an
# environment of their own; without the network their rows say so, and the others are measured.
#
# The figures are also in results/bench-<date>-<time>.json; those of a part in results/bench-<part>-<date>-<time>.json.
# Exit codes: 0 all bars that could be measured are met, 1 a bar is missed or something did not work, 2 bad usage,
# 130 interrupted.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"

readonly PEERS="$IM_ROOT/.venv-peers"

# install_peers: makes the environment of the peers, unless it is there; complete only when its stamp is written.
install_peers() {
  local wanted
  wanted="$(sha256sum <"$IM_ROOT/bench/peers/requirements.txt") $PEERS"
  [[ -x "$PEERS/bin/python" && "$(cat "$PEERS/.im-installed" 2>/dev/null)" == "$wanted" ]] && return
  say "bench: installing the peers into $PEERS (once)"
  rm -rf "$PEERS"
  "$IM_VENV/bin/python" -m venv "$PEERS" &&
    "$PEERS/bin/python" -m pip install --disable-pip-version-check --quiet --requirement "$IM_ROOT/bench/peers/requirements.txt" &&
    printf '%s\n' "$wanted" >"$PEERS/.im-installed"
}

part=""
arguments=()
for argument in "$@"; do
  case "$argument" in
    --nets | --mcs | --vss | --dom | --soak)
      [[ -z "$part" || "$part" == "${argument#--}" ]] || die 2 "--$part and $argument are two benchmarks; name one"
      part="${argument#--}"
      ;;
    *) arguments+=("$argument") ;;
  esac
done
if wants_help "$@" && [[ -z "$part" ]]; then help; exit 0; fi
"$IM_ROOT/scripts/setup.sh"
im_env
export PYTHONPATH="$IM_ROOT:$PYTHONPATH"
[[ "$part" == nets ]] || exec "$IM_VENV/bin/python" -m "bench.${part:-machine}" ${arguments[@]+"${arguments[@]}"}

peers=(--peers "$PEERS/bin/python")
if ! wants_help "$@" && ! install_peers; then
  peers=(--peers-missing "the peers could not be installed")
fi
exec "$IM_VENV/bin/python" -m bench.nets "${peers[@]}" --shipped "$IM_WS"/src/*/*/nets/*.yaml \
  --peer-programs "$IM_ROOT/bench/peers" ${arguments[@]+"${arguments[@]}"}
