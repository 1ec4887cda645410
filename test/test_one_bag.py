"""Two bags where one is due: the sentence that helps, from all that works on a bag."""

import pytest

from im_bag.ros import replay
from im_pnt_analysis.cli import main as pnt
from im_pnt_node.ros import rerun
from im_vss.ros import recalibrate


def replayed(words, monkeypatch):
    monkeypatch.setattr("sys.argv", ["replay", *words])
    replay.main()


@pytest.mark.parametrize(
    "run",
    [
        replayed,
        lambda words, _: recalibrate.main(["--recalibrate", *words]),
        lambda words, _: rerun.main(words),
        lambda words, _: pnt(["bag", *words]),
        lambda words, _: pnt(["display", *words]),
    ],
    ids=["replay", "recalibrate", "mission", "report", "display"],
)
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["bags/a", "bags/b"], "two bags are given, bags/a and bags/b; run the command once for each\n"),
        (["bags/a", "--loud"], "unrecognized arguments: --loud\n"),
    ],
)
def test_a_second_bag_is_refused_with_what_to_do(run, words, sentence, monkeypatch, capsys):
    with pytest.raises(SystemExit) as ended:
        run(words, monkeypatch)
    assert ended.value.code == 2
    assert capsys.readouterr().err.endswith(sentence)
