"""Files that messages name: only those of the machine are read, and answers quote little of what is in them."""

import base64
import os
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from im.net_files import read_net_file
from im_core.errors import SHOWN, ImError
from im_dispatcher.commands import load_named_net, parse_sent_net
from im_dispatcher.poses_file import load_named_poses
from im_pnt.netfile import describe, load_net

RNG = random.Random(7)


#: What was drawn: that alone is secret in the texts.
DRAWN: list[str] = []


def letters(count: int) -> str:
    DRAWN.append(base64.b64encode(RNG.randbytes(count), b"ab").decode()[:count])
    return DRAWN[-1]


KEY = "-----BEGIN PRIVATE KEY-----\n" + "\n".join(letters(64) for _ in range(20)) + "\n-----END PRIVATE KEY-----\n"
SHADOW = "".join(f"user{n}:$6${letters(16)}${letters(86)}:19000:0:99999:7:::\n" for n in range(20))
WORD = letters(3000)
#: Texts that nobody is to read, in the forms in which readers of nets and poses may quote them.
SECRETS = {
    "key": KEY,
    "shadow": SHADOW,
    "pairs": "".join(f"{letters(30)}: {letters(90)}\n" for _ in range(60)),
    "list": "".join(f"- {letters(90)}\n" for _ in range(60)),
    "tag": f"!{WORD} a\n",
    "alias": f"a: *{WORD}\n",
    "twice": f"{WORD}: 1\n{WORD}: 2\n",
    "long key": f"? {WORD}\n: 1\n",
    "names of poses": "group: left\nframe: world\nposes:\n"
    + "".join(f"  - {{name: {letters(99)}, position_m: {letters(70)}, {letters(70)}: 1}}\n" for _ in range(60)),
    "group": f"group: {WORD}\nframe: {WORD}\nposes: {WORD}\n",
    "net": f"net: {WORD}\nplaces: {{a: }}\ntransitions: {{t: {{in: a, out: a}}}}\n",
    "place": f"net: n\nplaces: {{{WORD}: }}\ntransitions: {{t: {{in: a, out: b}}}}\n",
    "arc": f"net: n\nplaces: {{a: }}\ntransitions: {{t: {{in: {WORD}, out: a}}}}\n",
    "guard": f"net: n\nplaces: {{a: }}\ntransitions: {{t: {{in: a, out: a, guard: '${{{WORD[:400]}}}'}}}}\n",
    "field": f"net: n\nplaces: {{a: {{{WORD}: 1}}}}\ntransitions: {{t: {{in: a, out: a}}}}\n",
    "use": f"net: n\nuse: [{{template: {WORD}}}]\nplaces: {{a: }}\ntransitions: {{t: {{in: a, out: a}}}}\n",
    "with": f"net: n\ntemplates: {{x: {{parameters: [i]}}}}\nuse: [{{template: x, with: {{{WORD}: 1}}}}]\n",
    "expression": "net: n\nuse: [{template: x, with: {i: 1}}]\n"
    f"templates: {{x: {{parameters: [i], places: {{'a$(i+{WORD[:150]})': }}}}}}\n",
    "symbol": f"net: n\nplaces: {{a: }}\ntransitions: {{t: {{in: a, out: a, symbol: '{WORD}'}}}}\n",
    "escalate": f"net: n\nescalate: {WORD[:190]}\nplaces: {{a: }}\ntransitions: {{t: {{in: a, out: a}}}}\n",
    "xml": f"<pnml><net id='{WORD}' type='{WORD}'><{WORD}/></net><net id='{WORD}'/></pnml>",
    "doctype": f"<!DOCTYPE {WORD}><pnml/>",
    "root": f"<{WORD}/>",
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The one folder that messages may name."""
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path / "results"))
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path / "run"))
    monkeypatch.delenv("IM_FOLDERS", raising=False)
    (tmp_path / "results").mkdir()
    return tmp_path / "results"


def quoted(answer: str, least: int = 8) -> int:
    """How many characters of what was drawn an answer holds, in pieces of ``least`` or more."""
    pieces = {text[at : at + least] for text in DRAWN for at in range(len(text) - least + 1)}
    begins = [at for at in range(len(answer)) if answer[at : at + least] in pieces]
    return len({at + further for at in begins for further in range(least)})


@pytest.mark.parametrize("form", SECRETS)
@pytest.mark.parametrize("load", [load_named_poses, load_named_net])
@pytest.mark.parametrize("suffix", [".yaml", ".pnml"])
def test_an_answer_quotes_little_of_a_file(folder: Path, form: str, load: Callable[[str], object], suffix: str) -> None:
    file = folder / f"f{suffix}"
    file.write_text(SECRETS[form])
    with pytest.raises(ImError) as refused:
        load(str(file))
    assert quoted(refused.value.message) <= SHOWN, refused.value.message


@pytest.mark.parametrize("load", [load_named_poses, load_named_net])
def test_a_file_of_elsewhere_is_not_read(folder: Path, load: Callable[[str], object]) -> None:
    secret = folder.parent / "secret.yaml"
    secret.write_text(SHADOW)
    (folder / "link.yaml").symlink_to(secret)
    (folder / "link.pnml").symlink_to(secret)
    for path in (str(secret), str(folder / "link.yaml"), "../secret.yaml", "/etc/passwd"):
        with pytest.raises(ImError, match=r"^(poses|net)_file: '.*' is outside of .*results"):
            load(path)
    with pytest.raises(ImError, match=r"^net_file: '.*' is outside of .*results"):
        load_named_net(str(folder / "link.pnml#net"))


def test_a_net_that_a_message_names_includes_nothing_of_elsewhere(folder: Path) -> None:
    secret = folder.parent / "secret.yaml"
    secret.write_text(SHADOW)
    (folder / "part.yaml").write_text("places: {b: }\n")
    net = folder / "net.yaml"
    net.write_text("net: n\ninclude: [part.yaml]\nplaces: {a: 1}\ntransitions: {t: {in: a, out: b}}\n")
    assert sorted(load_named_net(str(net)).places) == ["a", "b"]
    net.write_text(f"net: n\ninclude: [{secret}]\nplaces: {{a: 1}}\ntransitions: {{t: {{in: a, out: a}}}}\n")
    with pytest.raises(ImError, match=r"net\.yaml:2.*include: '.*' is outside of .*results"):
        load_named_net(str(net))


INCLUDED = {
    "mine/net.yaml": "net: n\ninclude: [parts/a.yaml, ../other/b.yaml, {absolute}]\nplaces: {{z: 1}}\n",
    "mine/parts/a.yaml": "include: [c.yaml]\nplaces: {a: }\n",
    "mine/parts/c.yaml": "include: [../../other/b.yaml]\nplaces: {c: }\n",
    "other/b.yaml": "transitions: {t: {in: z, out: b}}\nplaces: {b: }\n",
    "absolute.yaml": "places: {d: }\n",
}


def written(folder: Path, **others: str) -> Path:
    for name, text in {**INCLUDED, **others}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text.format(absolute=folder / "absolute.yaml") if name == "mine/net.yaml" else text)
    return folder / "mine" / "net.yaml"


def test_a_sent_net_includes_the_files_that_came_with_it_as_it_does_where_it_was_written(folder: Path) -> None:
    net = written(folder.parent)
    text, sent = read_net_file(net)
    there = load_net(net)
    for name in INCLUDED:
        (folder.parent / name).unlink()
    assert describe(parse_sent_net(text, sent)) == describe(there)


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("mine/parts/c.yaml", "include: [no.yaml]\n", r"^parts/c\.yaml:1:11: include\[0\]: 'no\.yaml' cannot be "
         r"included: it was not sent with the net, and is no shipped file$"),
        ("mine/parts/c.yaml", "include: [../../no.yaml]\n", r"^parts/c\.yaml:1:11: .*'../../no\.yaml' cannot be incl"),
        ("mine/parts/c.yaml", "include: a.yaml\n", r"^parts/c\.yaml:1:10: include: includes go round"),
        ("mine/parts/c.yaml", "places: [\n", r"^parts/c\.yaml:2:1: "),
        ("mine/parts/a.yaml", "net: m\n", r"^parts/a\.yaml:1:1: net: a file that is included \(by net:2\) is no net"),
        ("other/b.yaml", "transitions: {t: {in: y}}\n", r"^\.\./other/b\.yaml:1:23: transitions\.t\.in: there is no"),
        ("mine/net.yaml", "net: [\n", r"^net:2:1: "),
    ],
)  # fmt: skip
def test_a_fault_in_a_file_that_came_with_a_net_is_named_with_that_file(
    folder: Path, name: str, text: str, complaint: str
) -> None:
    with pytest.raises(ImError, match=complaint):
        parse_sent_net(*read_net_file(written(folder.parent, **{name: text})))


def test_a_sent_net_cannot_have_the_machine_read_a_file(folder: Path) -> None:
    (folder.parent / "secret.yaml").write_text("places: {a: }\n")
    for name in (f"{folder.parent}/secret.yaml", "../" * 20 + f"{folder.parent}/secret.yaml"):
        with pytest.raises(ImError, match="was not sent with the net, and is no shipped file"):
            parse_sent_net(f"net: n\ninclude: ['{name}']\n", {})


NET = "net: {}\nplaces: {{a: 1}}\ntransitions: {{t: {{in: a, out: a}}}}\n"
POSES = "group: left\nframe: world\nposes: [{{name: {}, position_m: [0, 0, 0], orientation_xyzw: [0, 0, 0, 1]}}]\n"
PNML = """<pnml><net id="{}" type="http://www.pnml.org/version-2009/grammar/ptnet"><page id="p">
<place id="a"/><transition id="t"/></page></net></pnml>"""
INCLUDING = "net: n\ninclude: [deep/f.yaml]\nplaces: {a: 1}\ntransitions: {t: {in: a, out: a}}\n"


@pytest.mark.parametrize("swapped", ["deep", "deep/{}"])
@pytest.mark.parametrize(
    ("load", "name", "text", "named"),
    [
        (load_named_poses, "f.yaml", POSES, "deep/f.yaml"),
        (load_named_net, "f.yaml", NET, "deep/f.yaml"),
        (load_named_net, "f.pnml", PNML, "deep/f.pnml#own"),
        (load_named_net, "f.yaml", "places: {{{}: }}\n", "including.yaml"),
    ],
)
def test_a_link_that_is_put_in_after_the_path_was_resolved_leads_nowhere(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    load: Callable[[str], object],
    name: str,
    text: str,
    named: str,
    swapped: str,
) -> None:
    outside, deep = folder.parent / "outside", folder / "deep"
    for place, word in ((outside, "secret"), (deep, "own")):
        place.mkdir()
        (place / name).write_text(text.format(word))
    (folder / "including.yaml").write_text(INCLUDING)
    load(named)
    real = os.open

    def swap(path: str | Path, *arguments: int) -> int:
        if Path(path).name == name and not deep.is_symlink() and not (deep / name).is_symlink():
            part = folder / swapped.format(name)
            part.rename(folder / "gone")
            part.symlink_to(outside / part.relative_to(deep), target_is_directory=part == deep)
        return real(path, *arguments)

    monkeypatch.setattr(os, "open", swap)
    with pytest.raises(ImError, match=rf"{name}.* leads out of .*results.* by a link, and is not read"):
        load(named)


def test_the_poses_and_nets_that_are_shipped_may_be_named(folder: Path) -> None:
    from im_cell.robot import load_cell
    from im_dispatcher.commands import NETS

    own = load_named_poses("")
    assert load_named_poses(load_cell().poses) == own
    assert load_named_net(str(NETS / "move.yaml")).name == "move"
