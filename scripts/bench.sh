#!/usr/bin/env bash
# Measures everything, or a part, against baselines of the same run: peers, bare libraries, the least it could cost.
# Absolute figures depend on the computer and on what else it does; the computer's own yardstick is in the table.
#
#   scripts/bench.sh                    all parts, an hour or two: one table, also in results/bench/<date>-<time>.md
#   scripts/bench.sh --quick            the same in about ten minutes on two quiet cores
#   scripts/bench.sh --quick --docs     and shown in docs/performance.md, with the figures of former versions
#   scripts/bench.sh --only mcs dom     only these parts of the table
#
# Parts by themselves; --PART --help tells what each has, --PART GROUP measures only that:
#
#   scripts/bench.sh --machine          start, command against its limit, memory, stop; real time, accuracy, pairs
#   scripts/bench.sh --sizes            cost against size: poses, arms, places, subscribers, bags
#   scripts/bench.sh --nets             firings, search, remote tokens, journal; against SNAKES, pm4py and libpetri
#   scripts/bench.sh --mcs              motion control: tracking, lines, the tick, deadlines, lockstep
#   scripts/bench.sh --vss              vision: frames and answers a second, and where the time goes
#   scripts/bench.sh --dom              data objects: puts and gets beside a bare service; 200 kills, 200 losses of power
#   scripts/bench.sh --bag              recording beside the machine: messages a second, gaps, the recorder's CPU time
#   scripts/bench.sh --calibration      the solver: errors over the bound and over OpenCV, coverage, verdicts
#   scripts/bench.sh --strategies       failed tries with learned strategies and with fixed orders, in a model of a world
#   scripts/bench.sh --display          the page: frames a second of a large net, the price of twenty viewers
#   scripts/bench.sh --spot             how well the light is found in an image
#   scripts/bench.sh --soak             does anything grow? 200 calibrations in a row; --soak random: for an hour
#
# The peers (SNAKES, libpetri, pm4py) are installed once, from bench/peers/requirements.txt into .venv-peers, an
# environment of their own; without the network their rows say so, and the others are measured.
#
# The figures of a part alone are in results/bench-<part>-<date>-<time>.json.
# Exit codes: 0 all bars that could be measured are met, 1 a bar is missed or something did not work, 2 bad usage,
# 130 interrupted.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"

part=""
arguments=()
for argument in "$@"; do
  case "$argument" in
    --machine | --sizes | --nets | --mcs | --vss | --dom | --bag | --calibration | --spot | --soak | --strategies | --display)
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
exec "$IM_VENV/bin/python" -m "bench.${part:-page}" ${arguments[@]+"${arguments[@]}"}
