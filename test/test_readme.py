"""The lines of README.md work when they are typed as they stand, in their order."""

import re
import subprocess
from pathlib import Path

README = (Path(__file__).resolve().parent.parent / "README.md").read_text(encoding="utf-8")
STAND_IN = """
need() { [[ -e "$1" ]] || { echo "$script $*: there is no $1" >&2; exit 1; }; }
option() { local word; for word; do [[ "$found" ]] && echo "$word" && return; [[ $word == "$name" ]] && found=1; done; }
script="$(basename "$0")" found=""
case "$script $*" in
  start.sh*) [[ ! -e machine ]] || { echo "start.sh $*: a machine runs" >&2; exit 1; }
    name=--calibration; calibration="$(option "$@")"; [[ -z "$calibration" ]] || need "$calibration"; touch machine ;;
  stop.sh*) need machine; rm machine ;;
  record.sh*) name=-o; bag="$(option "$@")"; mkdir -p "$bag"; trap 'touch "$bag/whole"; exit' TERM
    while :; do touch "$bag/begun"; sleep 0.05; done ;;
  calibrate_camera.sh*) need machine; name=--poses; poses="$(option "$@")"; [[ -z "$poses" ]] || need "$poses"
    until [[ -e bags/demo/begun ]]; do sleep 0.05; done; [[ ! -e bags/demo/whole ]] || exit 1
    mkdir -p results/latest ;;
  bag_report.sh*) need "$1/whole" ;;
  replay.sh*) need "$1/whole"; [[ ! -e machine ]] || exit 1 ;;
  "run.sh im_mcs poses"*) name=--output; touch "$(option "$@")" ;;
  "im run"* | "im dom"* | "im recover"*) need machine ;;
esac
"""
"""Stands for every script: what each needs of those before, and leaves to those after."""


def block(title):
    """The lines below a title."""
    return re.search(rf"^## {title}\n+```\n(.*?)```", README, re.DOTALL | re.MULTILINE)[1]


def test_each_step_finds_what_it_needs_of_those_before_it(tmp_path):
    lines = block("Step by step")
    (tmp_path / "scripts").mkdir()
    for name in set(re.findall(r"^scripts/(\S+)", lines, re.MULTILINE)):
        script = tmp_path / "scripts" / name
        script.write_text(f"#!/usr/bin/env bash{STAND_IN}")
        script.chmod(0o755)
    done = subprocess.run(
        ["bash", "-e", "-c", lines], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
