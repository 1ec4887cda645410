import pytest

from im_pnt.errors import NetFileError
from im_pnt.expression.errors import ExpressionError
from im_pnt.netfile import load_net, parse_net
from im_pnt.netfile.templates import evaluated, substitute

RING = """\
net: philosophers
templates:
  philosopher:
    parameters: [i, n]
    places: {thinking$(i): 1, fork$(i): 1, eating$(i): }
    transitions:
      take$(i): {in: [thinking$(i), fork$(i), fork$(i+1 mod n)], out: eating$(i)}
      drop$(i): {in: eating$(i), out: [thinking$(i), fork$(i), fork$(i+1 mod n)]}
use:
  - {template: philosopher, for: {i: 0..4}, with: {n: 5}}
"""


def test_a_ring_is_written_once():
    net = parse_net(RING)
    assert len(net.places) == 15
    assert net.transitions["take4"].inputs == {"thinking4": 1, "fork4": 1, "fork0": 1}
    assert sum(net.initial_marking().values()) == 10
    assert net.transitions["drop3"].line == 8


@pytest.mark.parametrize(
    ("find", "replace", "complaint"),
    [
        ("n: 5}", "m: 5}", r"ring:10:52: use\[0\].with.m: template philosopher has no parameter 'm'"),
        (", with: {n: 5}", "", "template philosopher needs a value for its parameter 'n'"),
        ("template: phil", "template: fil", r"ring:10:16: .*no template 'filosopher' \(did you mean 'philosopher'"),
        ("0..4", "4..0", "'4..0' is empty: it ends before it begins"),
        ("0..4", "0-4", "'0-4' is neither a range like 0..4 nor a list"),
        ("0..4", "0..999999", "has more than 10000 values"),
        ("for: {i: 0..4", "for: {i: 0..999, j: 0..999", "asks for 1000000 copies; 10000 are allowed"),
        ("n: 5}", "n: 0}", r"ring:7:\d+: templates.philosopher.transitions: \(\(i \+ 1\) mod n\) divides by 0"),
        ("n: 5}", "n: five}", "n is 'five', not a number"),
        ("i+1 mod n", "i+1 mod k", r"there is no parameter 'k' .*used in ring:10:5\)"),
        ("i+1 mod n", "i+1 mod n", None),
        ("i+1 mod n", "i ^ n", r"'\^' is not allowed"),
        ("i+1 mod n", "i +", "a value is missing at its end"),
        ("i+1 mod n", "i / n", r"'i / n' is 0.0, neither a whole number nor a text"),
        ("i+1 mod n", "arguments.i", "there is no parameter 'arguments'"),
        ("$(i+1 mod n)]", "$(i]", "has no closing parenthesis"),
        ("eating$(i): }", "eating: }", r"ring:5:44: places: 'eating' is there twice; the first is in line 5 \(t"),
        ("fork$(i+1 mod n)", "fork$(i+1)", r"ring:7:47: .*no place 'fork5'.*with i=4, n=5, used in ring:10:5\)$"),
        ("[i, n]", "[i, i]", "'i' cannot be a parameter here"),
        ("[i, n]", "[i, mod]", "'mod' cannot be a parameter here"),
        ("[i, n]", "[i, in]", "'in' cannot be a parameter here"),
        ("    parameters", "    params", "'params' is not a known key"),
    ],
)
def test_mistakes_point_into_the_template_and_at_its_use(find, replace, complaint):
    assert find in RING
    text = RING.replace(find, replace, 1)
    if complaint is None:
        parse_net(text, "ring")
        return
    with pytest.raises(NetFileError, match=complaint):
        parse_net(text, "ring")


def test_copies_take_texts_lists_and_values_of_what_is_run_through():
    net = parse_net(
        "net: n\nplaces: {start: 2}\ntemplates:\n  arm:\n    parameters: [side, other, tokens]\n"
        "    places: {$(side)_idle: $(tokens)}\n    rest: [$(side)_idle]\n"
        "    transitions:\n      $(side)_go: {in: [start, $(side)_idle], out: $(other)_idle, symbol: $(side)}\n"
        "use:\n  template: arm\n  for: {side: [left, right]}\n  with: {other: $(side), tokens: 3}\nrest: start\n"
    )
    assert net.rest == ("start", "left_idle", "right_idle")
    assert net.places["right_idle"].tokens == 3
    assert net.transitions["left_go"].symbol == "left"


QUOTED = """net: n
places: {start: 1}
templates:
  arm:
    parameters: [side, home, count, on]
    places: {$(side)_idle: "$(count)"}
    transitions:
      $(side)_go:
        in: start
        out: "$(side)_idle"
        on_failure: start
        delay: "$(late)"
        topic:
          name: "/$(side)/a$(count)"
          type: a/msg/B
          message: {data: ["$(home)", "$(count+1)", "$(side)", "$(on)", "at $(home)", "$(count)$(count)"]}
use: {template: arm, with: {side: left, home: -0.50, count: 3, on: true, late: 2.5}}
"""


def test_a_quoted_value_keeps_its_type():
    net = parse_net(QUOTED.replace("count, on]", "count, on, late]"))
    assert net.places["left_idle"].tokens == 3
    go = net.transitions["left_go"]
    assert go.action.fields["data"] == [-0.5, 4, "left", True, "at -0.50", "33"]
    assert (go.action.name, go.delay.mean) == ("/left/a3", 2.5)


@pytest.mark.parametrize(
    ("text", "value"),
    [("i", 7), ("i+1 mod 8", 0), ("-1 mod n", 2), ("(i-1)*2", 12), ("2*i+1", 15), ("1+(i mod 2)", 2), ("word", "left")],
)
def test_expressions_are_what_they_are_in_print(text, value):
    assert evaluated(text, {"i": 7, "n": 3, "word": "left"}) == value


@pytest.mark.parametrize(
    "text",
    ["", "()", "i i", "i == 1.5", "i**2", "a.b", "i.b", "9" * 20, "(" * 300, f"{10**10}*{10**10}", "mod", "i == 7"],
)
def test_what_is_no_expression_is_refused(text):
    with pytest.raises(ExpressionError):
        evaluated(text, {"i": 7})


def test_a_text_without_expressions_stays():
    assert substitute("a$b (c) $", {}) == "a$b (c) $"


def write(folder, **files):
    for name, text in files.items():
        (folder / f"{name}.yaml").write_text(text)
    return folder / f"{next(iter(files))}.yaml"


def test_included_files_bring_parts_and_templates(tmp_path):
    (tmp_path / "sub").mkdir()
    write(tmp_path / "sub", parts="include: [more.yaml]\nplaces: {b: }\n", more="transitions: {u: {in: b, out: a}}\n")
    main = write(
        tmp_path,
        main="net: n\ninclude: [sub/parts.yaml, sub/more.yaml]\nplaces: {a: 1}\ntransitions: {t: {in: a, out: b}}\n",
    )
    net = load_net(main)
    assert list(net.places) == ["b", "a"]
    assert list(net.transitions) == ["u", "t"]
    with pytest.raises(NetFileError, match=r"sub/more\.yaml:1:31: transitions\.u\.out: there is no place 'a'"):
        load_net(write(tmp_path, main="net: n\ninclude: sub/parts.yaml\nplaces: {c: 1}\ntransitions: {t: {in: c}}\n"))


@pytest.mark.parametrize(
    ("files", "complaint"),
    [
        ({"a": "net: n\ninclude: b.yaml\n", "b": "include: a.yaml\n"}, r"go round: .*a\.yaml -> .*b\.yaml -> .*a\."),
        ({"a": "net: n\ninclude: a.yaml\n"}, r"a\.yaml:2:10: include: includes go round: "),
        ({"a": "net: n\ninclude: [b.yaml, no.yaml]\n", "b": ""}, r"b\.yaml:1:1: the file is empty"),
        ({"a": "net: n\ninclude: no.yaml\n"}, r"a\.yaml:2:10: include: cannot be included: .*no\.yaml:1: cannot"),
        ({"a": "net: n\ninclude: b.yaml\n", "b": "net: m\n"}, r"b\.yaml:1:1: net: .*\(by .*a\.yaml:2\) is no net"),
        ({"a": "net: n\ninclude: b.yaml\n", "b": "place: {}\n"}, r"'place' is not a known key \(did you mean 'places'"),
        (
            {"a": "net: n\ninclude: b.yaml\nplaces: {p: }\ntransitions: {t: {in: p}}\n", "b": "places: {p: 1}\n"},
            r"a\.yaml:3:10: places: 'p' is there twice; the first is in .*b\.yaml:1",
        ),
        (
            {"a": "net: n\ninclude: b.yaml\ntemplates: {t: }\n", "b": "templates: {t: }\n"},
            r"template 't' is there twice; the first is in .*b\.yaml:1",
        ),
        (
            {f"a{k}": f"{'net: n' if k == 0 else 'places: {}'}\ninclude: a{k + 1}.yaml\n" for k in range(12)},
            r"includes are deeper than 8: .*a0\.yaml -> .*a1\.yaml -> ",
        ),
    ],
)
def test_includes_that_lead_nowhere_are_named(tmp_path, files, complaint):
    with pytest.raises(NetFileError, match=complaint):
        load_net(write(tmp_path, **files))
