import re
from pathlib import Path

import pytest

from im_pnt.netfile import load_net
from im_pnt.netfile.schema.delays import DelayFile
from im_pnt.netfile.schema.net import NetFile
from im_pnt.netfile.schema.places import PlaceFile
from im_pnt.netfile.schema.transitions import TransitionFile
from im_pnt_analysis.cli import main
from im_pnt_analysis.cli.terminal import OK, REFUSED

DOCS = Path(__file__).resolve().parents[4] / "docs"
PAGE = (DOCS / "nets.md").read_text(encoding="utf-8")
SHOWN = re.findall(r"\[`nets/(\w+\.yaml)`\]\(nets/\1\)\n```yaml\n(.*?)```", PAGE, re.DOTALL)
RUNS = re.findall(r"```console\n\$ scripts/im pnt (.*?)\n(.*?)\n\.\.\.\n```", PAGE, re.DOTALL)


def test_the_page_shows_the_files_that_are_there():
    files = {file.name: file.read_text(encoding="utf-8") for file in (DOCS / "nets").glob("*.yaml")}
    assert dict(SHOWN) == files


@pytest.mark.parametrize(("command", "shown"), RUNS, ids=[command for command, _ in RUNS])
def test_what_the_page_shows_is_what_pnt_prints(command, shown, capsys, monkeypatch):
    monkeypatch.chdir(DOCS.parent)
    result = main(command.split())
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert set(shown.splitlines()) <= set(printed)
    assert result == (REFUSED if "REFUSED" in shown else OK)


def test_ten_nets_are_refused_each_for_a_reason_of_its_own():
    ten = PAGE.partition("## Ten nets that are refused\n")[2].partition("\n## ")[0]
    refused = [shown for _, shown in RUNS if "REFUSED" in shown and shown in ten]
    assert len(refused) == 10
    assert len({line for shown in refused for line in shown.splitlines() if " refused " in line}) >= 10
    assert all(" after " in shown for shown in refused)


def test_each_net_of_two_is_verified_alone():
    for name in ("circular_wait_arm.yaml", "circular_wait_camera.yaml"):
        assert main(["verify", str(DOCS / "nets" / name)]) == OK


def test_the_page_explains_every_key():
    tables = set(re.findall(r"`(\w+)`", "\n".join(line for line in PAGE.splitlines() if line.startswith("| `"))))
    models = (NetFile, PlaceFile, TransitionFile)
    assert {field.alias or name for model in models for name, field in model.model_fields.items()} <= tables
    assert all(f"`{{{kind}:" in PAGE for kind in DelayFile.model_fields)


def test_the_ring_is_a_ring():
    net = load_net(DOCS / "nets" / "philosophers.yaml")
    assert net.transitions["take4"].inputs == {"thinking4": 1, "fork4": 1, "fork0": 1}
