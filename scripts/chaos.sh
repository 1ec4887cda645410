#!/usr/bin/env bash
# Throws faults at a running machine and judges what it does about them: starts it, runs calibrate_camera with few poses
# again and again, and meanwhile kills and stops its processes at moments drawn from a seed.
#
#   scripts/chaos.sh --minutes 10            as many injections as fit in
#   scripts/chaos.sh --injections 500        so many
#   scripts/chaos.sh --seed 42 --injections 1    repeats the injection that was told as 42
#   scripts/chaos.sh --kinds kill stop --roles servo mcs --injections 20    only these
#   scripts/chaos.sh --factor 1              in real time
#   scripts/chaos.sh --everything --injections 50    kills all processes, starts the machine again (and kills that
#                                            start, too, in every second injection), and compares what
#                                            the command then finds with what it finds undisturbed
#   scripts/chaos.sh --everything --power disk --injections 20    the power goes, too: what was not synchronised is
#                                            there by chance only; with journal_sync: disk, or os
#   scripts/chaos.sh --demo --injections 20  signals to scripts/demo.sh instead, and the end of its terminal
#   scripts/chaos.sh --hosts 2 --injections 20    a machine over two (or 3) hosts, which are namespaces of this
#                                            computer: links, frames, hosts and agents fail
#   scripts/chaos.sh --port 8081             another port for the display of the machine
#   scripts/chaos.sh --minutes 30 --out results/chaos.jsonl    in pieces: adds to the file, goes on with its next seed
#   scripts/chaos.sh --out results/chaos.jsonl --docs docs/evidence/reliability.md    writes the table there, no injection
#
# Kinds: kill, kill-two, stop (1, 15 or 60 s), malformed, clock, second, load, disk, journal, lifecycle (shutdown of
# /mcs). Roles: servo, physics, cameras, bootstrap, and the tasks: testbed, mcs, vss, dom, dispatcher, pnt_display,
# <which>_coordinator. With --hosts the kinds are cut (a link, for 20 s), weather (frames lost, late and reordered for
# 20 s), host (killed, and on again), late (likewise, with its link down when its agent begins) and agent (killed).
#
# Each injection must end with a true answer to the command (success, or a reason that names who failed), the next
# command must succeed without a restart of the machine, and nothing may be left behind. Prints a table fault x outcome.
# Exit codes: 0 no failure, 1 failures (each with its seed), 2 bad usage, 130 interrupted.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
if wants_help "$@"; then help; exit 0; fi
"$IM_ROOT/scripts/setup.sh"
im_env
export PYTHONPATH="$IM_ROOT:$PYTHONPATH"
exec "$IM_VENV/bin/python" -m bench.chaos "$@"
