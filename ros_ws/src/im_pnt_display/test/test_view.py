"""``im view`` prints the address of the page, opens it where there is a screen, and says where there is none."""

import sys

import pytest

from im_core.names import display_file
from im_core.processes import host_record
from im_pnt_display.cli import view

ADDRESS = "http://localhost:8080/?token=secret"


@pytest.fixture
def opened(tmp_path, monkeypatch):
    """Addresses that the browser was asked to open; nothing of this session's screen is left."""
    addresses = []
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    monkeypatch.setattr("webbrowser.open", addresses.append)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "argv", ["view"])
    return addresses


def test_the_address_is_printed_and_opened_where_there_is_a_screen(opened, monkeypatch, capsys):
    display_file().write_text(f"{ADDRESS}\n")
    assert view() == 0
    assert (capsys.readouterr().out, opened) == (f"{ADDRESS}\n", [])
    monkeypatch.setenv("DISPLAY", ":0")
    assert view() == 0
    assert opened == [ADDRESS]


def test_where_no_machine_shows_a_page_it_says_how_to_come_to_one(opened, capsys):
    assert view() == 3
    said = capsys.readouterr().err
    assert said == "im view: no machine shows a page here; scripts/start.sh starts one, im view BAG shows a recording\n"


def test_on_a_host_of_several_it_finds_the_page_of_a_task_there_and_names_a_host_without_one(
    opened, tmp_path, monkeypatch, capsys
):
    folder = tmp_path / "display"
    folder.mkdir()
    monkeypatch.setattr(host_record, "SHM", tmp_path)
    host_record.write("display", True, folder, {})
    assert view() == 3
    assert capsys.readouterr().err.startswith("im view: host display serves no page; im tasks shows the host of ")
    (folder / display_file().name).write_text(f"{ADDRESS}\n")
    assert view() == 0
    assert capsys.readouterr().out == f"{ADDRESS}\n"


def test_a_bag_that_is_none_is_named(opened, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sys, "argv", ["view", str(tmp_path / "nowhere")])
    assert view() == 1
    assert "nowhere" in capsys.readouterr().err
