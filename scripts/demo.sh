#!/usr/bin/env bash
# The whole machine at work, from a clean clone: sets up what is missing, starts the machine, calibrates the two ceiling
# cameras with the light on the arm, compares the result with the truth that only the testbed knows, and stops it all.
#
#   scripts/demo.sh                     simulated time as fast as it goes
#   scripts/demo.sh --factor 1          in real time
#   scripts/demo.sh --seed 7            another seed: other cameras, other noise
#   scripts/demo.sh --poses FILE        other poses
#   scripts/demo.sh --perfect-arm       arms as drawn; without it the tool is off by 0.3 to 1 mm
#   scripts/demo.sh --record            and a bag of it, into bags/
#   scripts/demo.sh --mission handover  the other mission: calibrates the camera on the left wrist, finds a part on the
#                                       table with it, hands it from arm to arm, sets it down; handover.png shows it
#
# Results: results/latest (report.json, summary.txt, pictures). The machine is stopped in any case: after Ctrl-C, SIGTERM
# and SIGHUP, and when the terminal is closed. After kill -9 of this script the machine goes on; scripts/stop.sh ends it.
# Exit codes: 0 calibrated, 1 something failed (said what), 2 bad usage, 4 the computer lacks something,
# 130 interrupted.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/lib.sh"
if wants_help "$@"; then help; exit 0; fi

factor=0 seed=1 port="" poses="" mission=calibration record=0 cameras=() arm=()
while (($#)); do
  case "$1" in
    --factor | --seed | --port | --poses | --mission)
      (($# > 1)) || die 2 "$1 needs a value; --help tells more"
      declare "${1#--}=$2"
      shift 2
      ;;
    --record) record=1; shift ;;
    --perfect-arm) arm=("$1"); shift ;;
    *) die 2 "unknown argument $1; --help tells what there is" ;;
  esac
done
[[ -z "$poses" || -r "$poses" ]] || die 2 "there is no poses file $poses"
case "$mission" in
  calibration) ;;
  handover)
    cell="$IM_WS/src/im_cell/im_cell/cells/puma_pair"
    export IM_OBJECTS="$cell/objects.yaml"
    cameras=(--cameras wrist_left)
    poses="${poses:-$cell/wrist_left_18.yaml}"
    ;;
  *) die 2 "there is no mission $mission; there are calibration and handover" ;;
esac

child="" recorder="" started=0 interrupted=0 again=0

# A signal ends the command that runs, and no more: where the script is then decides what there is to put away.
interrupt() {
  interrupted=1 again=1
  if [[ -n "$child" ]]; then kill -TERM "$child" 2>/dev/null || true; fi
}
# Commands run in the background, so that a signal is acted on at once and not after the command's end.
run() {
  local code=0
  if ((interrupted)); then return 130; fi
  "$@" &
  child=$!
  if ((interrupted)); then interrupt; fi  # it came when there was no child to end
  again=1
  while ((again)); do  # a wait that a signal cut short tells nothing of the child
    again=0 code=0
    wait "$child" || code=$?
  done
  child=""
  return "$code"
}
finish() {
  trap '' INT TERM HUP
  trap - EXIT
  local code="$1"
  if ((interrupted)); then code=130; fi
  if [[ -n "$recorder" ]]; then
    kill -TERM "$recorder" 2>/dev/null || true
    wait "$recorder" || true
  fi
  if ((started)); then "$IM_BRINGUP/stop" || code=1; fi
  exit "$code"
}
trap 'finish $?' EXIT
trap interrupt INT TERM HUP

"$IM_ROOT/scripts/setup.sh"
im_env
if ((record)); then  # before the machine: what is volatile reaches only who is there
  "$IM_BAG/record" &
  recorder=$!
fi
started=1
run "$IM_BRINGUP/start" --fresh --factor "$factor" --seed "$seed" ${port:+--port "$port"} ${arm[@]+"${arm[@]}"} || {
  code=$?
  started=0  # it says why, and has left nothing; a machine that runs already is not of this script
  exit "$code"
}
run "$IM_BRINGUP/run_command" calibrate_camera ${cameras[@]+"${cameras[@]}"} ${poses:+--poses-file "$(realpath -- "$poses")"}
say ""
if [[ "$mission" == calibration ]]; then
  say "against the truth, which only the testbed knows:"
  run "$IM_BRINGUP/truth_error"
else
  run "$IM_VENV/bin/python" "$IM_ROOT/examples/handover.py" --output "$(readlink -f "$IM_RESULTS_DIR/latest")"
  say "where it is, which only the testbed knows:"
  run "$IM_BRINGUP/truth_error" --object part
fi
say ""
latest="$(readlink "$IM_RESULTS_DIR/latest")"
say "report    results/$latest/report.json"
for picture in "$IM_RESULTS_DIR/$latest"/*.png; do
  if [[ -e "$picture" ]]; then say "picture   results/$latest/$(basename "$picture")"; fi
done
