# Completes subcommands of `im`, commands of the machine, their options and choices. Source it; scripts/shell.sh does.
# What the machine can be told is in commands.txt of its run folder, as `im run` has heard it last: a line a command.
# Names of topics, services, actions and nodes are likewise those that `im topic list` and so on have shown last; numbers
# of commands under way those of `im run`.
# Where nothing of this is known, files are completed.
# shellcheck shell=bash

_IM_CLONE="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"

_im() {
  local word="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD - 1]}" words
  local run="${IM_RUN_DIR:-$_IM_CLONE/.run/im${ROS_DOMAIN_ID:-0}}"
  local list="$run/commands.txt"
  declare -A verbs=(
    [action]="info list send_goal type" [cell]="check export new" [dom]="append get invalidate list put"
    [lifecycle]="get list nodes set" [node]="info list" [param]="get list set" [security]="make"
    [pnt]="bag convert display draw fit journal mission policy run schema simulate test time verify"
    [service]="call list type" [topic]="echo hz info list pub type" [vss]="run"
  )
  COMPREPLY=()
  if ((COMP_CWORD == 1)); then
    words="action calibrate cell doctor dom lifecycle load node param pnt recover run security service strategies tasks topic unload view vss"
  elif ((COMP_CWORD == 2)) && [[ -n "${verbs[${COMP_WORDS[1]}]:-}" ]]; then
    words="${verbs[${COMP_WORDS[1]}]}"
  elif ((COMP_CWORD == 3)) && [[ -n "${verbs[${COMP_WORDS[1]}]:-}" ]]; then
    case "${COMP_WORDS[1]}" in
      cell) words="$(cd "$_IM_CLONE/ros_ws/src/im_cell/im_cell/cells" && echo *)" ;;
      lifecycle | param) words="$(cat "$run/nodes.txt" 2>/dev/null)" ;;
      *) words="$(cat "$run/${COMP_WORDS[1]}s.txt" 2>/dev/null)" ;;
    esac
  elif [[ "${COMP_WORDS[1]}" != run ]]; then
    return
  elif ((COMP_CWORD == 2)); then
    words="$(cut -d' ' -f1 "$list" 2>/dev/null) --attach --cancel --pause --resume --abandon"
  elif [[ "$before" =~ ^--(attach|cancel|pause|resume|abandon)$ ]]; then
    words="$(cat "$run/numbers.txt" 2>/dev/null)"
  elif [[ ! -r "$list" ]]; then
    return
  else
    # Of `--group=left=right`: the option, or behind it its choices.
    words="$(awk -v name="${COMP_WORDS[2]}" -v before="$before" '$1 == name {
      for (i = 2; i <= NF; i++) {
        n = split($i, part, "=")
        if (part[1] == before && n > 1) { for (j = 2; j <= n; j++) print part[j]; chosen = 1 }
        else options = options " " part[1]
      }
      if (!chosen) print options
    }' "$list")"
  fi
  mapfile -t COMPREPLY < <(compgen -W "$words" -- "$word")
}
complete -o default -F _im im
