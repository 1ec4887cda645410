"""``pnt journal``: journals are shown as they are, also those in use, and moved aside when told to."""

import pytest

from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Command
from im_pnt.netfile import parse_net
from im_pnt_analysis.cli import main
from im_pnt_analysis.cli.terminal import BAD_INPUT, OK
from im_pnt_node.journal.folder import Folder
from support.journalled import JournalledProcess

NET = parse_net(
    """
net: kitchen
places: {idle: 1, hot: , bad: }
transitions:
  boil: {in: idle, out: [hot, dining.table], symbol: tea, action: heat, on_failure: bad}
"""
)


@pytest.fixture
def cook(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))

    async def heat(ctx: ActionContext) -> None:
        return None

    process = JournalledProcess("cook", [NET], Folder(tmp_path / "journal" / "cook"), actions={"heat": heat})
    process.exchange.nets["kitchen"].command(Command(7, "tea"))
    process.turn()
    yield process
    process.journal.close()


def said(capsys, *words):
    code = main(["journal", *words])
    out, err = capsys.readouterr()
    return code, out + err


def test_a_journal_is_shown_while_its_node_writes_it(cook, capsys):
    code, text = said(capsys, "show", "cook")
    assert code == OK
    assert "cook: nets kitchen; 5 entries since the snapshot" in text
    assert "net kitchen: idle=1; running: nothing" in text
    assert 'net kitchen              ["command", [7, "tea", {}, 0, ""]]' in text
    assert '["fire", "boil.start", null]' in text
    assert '["out", "dining", 1, [1, "dining", ["token", "table", 1, [[["' in text  # command 7's
    assert said(capsys, "show", "cook", "--entries", "1")[1].count("net kitchen  ") == 0
    cook.journal.compact()
    assert "net kitchen: hot=1; running: nothing" in said(capsys, "show", "cook")[1]
    assert "link to dining: 1 messages sent, 1 of them not acknowledged; 0 taken" in said(capsys, "show", "cook")[1]
    assert said(capsys, "show")[1].startswith("cook: nets kitchen; 0 entries since the snapshot")


def test_a_journal_in_use_is_not_discarded_and_another_is_moved_aside(cook, capsys, tmp_path):
    code, text = said(capsys, "discard", "cook")
    assert code == BAD_INPUT
    assert "the journal is in use by process" in text
    cook.journal.close()
    code, text = said(capsys, "discard", "cook")
    assert code == OK
    (aside,) = (tmp_path / "journal" / "cook").glob("discarded-*")
    assert str(aside) in text
    assert said(capsys, "show", str(aside))[1].startswith("cook: nets kitchen; 5 entries")
    assert said(capsys, "discard", "cook")[0] == BAD_INPUT
    assert said(capsys, "show", "cook")[0] == BAD_INPUT


def test_torn_and_damaged_journals_are_named(cook, capsys, tmp_path):
    cook.journal.close()
    (file,) = (tmp_path / "journal" / "cook").glob("*.journal")
    content = file.read_bytes()
    file.write_bytes(content[:-3])
    assert "its last record is torn" in said(capsys, "show", "cook")[1]
    assert file.read_bytes() == content[:-3]
    file.write_bytes(content.replace(b"kitchen", b"kitschn", 1))
    code, text = said(capsys, "show", "cook")
    assert code == BAD_INPUT
    assert f"{file}: record 1 at byte 0 is damaged" in text


def test_journals_within_a_folder_are_named(cook, capsys, tmp_path):
    code, text = said(capsys, "show", str(tmp_path / "journal"))
    assert code == BAD_INPUT
    assert f"(known: {tmp_path / 'journal' / 'cook'})" in text
    assert said(capsys, "show", str(tmp_path / "journal" / "cook"))[0] == OK


@pytest.mark.parametrize("name", ["cok", "..", "", "no/where", "a\0b"])
def test_a_name_that_is_none_is_one_sentence(cook, capsys, name, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    for command in ("show", "discard"):
        code, text = said(capsys, command, name)
        assert code == BAD_INPUT
        assert text.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("words", [["--help"], ["show", "--help"], ["discard", "--help"]])
def test_help_teaches(words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["journal", *words])
    assert ended.value.code == 0
    assert "journal" in capsys.readouterr().out
