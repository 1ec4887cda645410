import copy
import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import jsonschema
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.errors import NetFileError
from im_pnt.model.action import (
    AwaitAction,
    FunctionAction,
    GoalAction,
    RequestAction,
    ServiceAction,
    TopicAction,
    ValuesAction,
)
from im_pnt.model.arguments import Argument, ArgumentSchema, ArgumentType, Busy, CommandDeclaration
from im_pnt.model.delay import Delay
from im_pnt.model.net import (
    LARGEST,
    Assumption,
    Guard,
    Net,
    ObjectScope,
    Place,
    ReadFor,
    RemotePlace,
    Service,
    Strategy,
    Transition,
)
from im_pnt.netfile import describe, load_net, parse_net, schema_text, yaml_text
from im_pnt.netfile.assume import faults
from im_pnt.pnml import pnml_text

NAMESPACE = "http://www.pnml.org/version-2009/grammar/pnml"
NCNAME = re.compile(r"[A-Za-z_][\w.-]*", re.ASCII)

WORDS = ["a", "b", "yes", "null", "arc_1", "page", "Q7", "long_name", "_x", "I", "remote_1", "on"]
names = st.sampled_from(WORDS)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
shown = st.text(st.characters(exclude_categories=["Cs", "Cc"], exclude_characters="\ufffe\uffff"), max_size=8)
finite = st.floats(allow_nan=False, allow_infinity=False)
data = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-(10**18), 10**18), finite, texts),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(shown, inner, max_size=3),
    max_leaves=5,
)
fields = st.dictionaries(shown, data, max_size=3)
optional = st.none() | names
ros_names = names | st.sampled_from(["/a", "/a/b_1", "~/x", "/{node}/on", "on/_x"])
acted_on = st.none() | st.lists(shown, max_size=3).map(tuple)
functions = optional | st.just("mine.arms:reach")
positive = st.floats(0.01, 1e6)


@st.composite
def delays(draw_):
    low, middle, high = sorted(draw_(st.tuples(positive, positive, positive)))
    return draw_(
        st.sampled_from(
            [
                Delay("constant", (low,)),
                Delay("exponential", (low,)),
                Delay("uniform", (low, high)),
                Delay("triangular", (low, high, middle)),
                Delay("gamma", (low, high)),
                Delay("weibull", (low, 1.0 + high)),
                Delay("lognormal", (1.0, min(low, 5.0))),
            ]
        )
    )


actions = st.one_of(
    st.builds(FunctionAction, names | st.just("mine:act")),
    st.builds(ServiceAction, ros_names, st.just("p/srv/Do"), fields, functions, functions, optional),
    st.builds(GoalAction, ros_names, st.just("p/action/Move"), fields, functions, functions, optional),
    st.builds(TopicAction, ros_names, st.just("p/msg/Word"), fields, functions),
    st.builds(
        AwaitAction,
        ros_names,
        st.just("p/msg/Word"),
        st.booleans(),
        functions,
        st.none() | st.just("${1 < 2}"),
        st.none() | st.just(2.5),
    ),
    st.builds(RequestAction, names, names, fields, functions),
    st.builds(ValuesAction),
)
EXPRESSIONS = ["${command.id > 3}", "${failure.code in ['a', '}']}", "${not (1 mod 2 == 0)}"]


@st.composite
def arguments(draw_, name):
    """Arguments of every kind that an author could write."""
    kind = draw_(st.sampled_from(list(ArgumentType)))
    low, high = sorted(draw_(st.tuples(st.integers(-5, 5), st.integers(-5, 5))))
    limits = draw_(st.sampled_from([(None, None), (low, None), (None, high), (low, high)])) if kind.is_numeric else ()
    sized = kind.is_list or kind is ArgumentType.STRING
    length = draw_(st.none() | st.sampled_from([(0, 3), (2, 2), (1, 4)])) if sized else None
    one = {"boolean": st.booleans(), "string": shown, "object": data}.get(kind.element, st.integers(low, high))
    choices = tuple(draw_(st.lists(one, max_size=3)))
    required, default = draw_(st.booleans()), None
    unit = draw_(st.sampled_from(["", "m", "rad/s"])) if kind.is_numeric else ""
    if not required:
        least, most = length or (0, 3)
        element = st.sampled_from(choices) if choices else one
        if kind.is_list:
            default = draw_(st.lists(element, min_size=least, max_size=most))
        elif kind is ArgumentType.STRING and length is not None:
            default, choices = "x" * least, ()
        else:
            default = draw_(element)
    return Argument(name, kind, unit, *(limits or (None, None)), choices, length, required, default, draw_(shown))


@st.composite
def schemas(draw_):
    some = draw_(st.lists(names, max_size=2, unique=True))
    return ArgumentSchema({name: draw_(arguments(name)) for name in some})


def returned(action):
    """What a transition may return."""
    if action is None:
        return st.just({})
    least = 1 if action == ValuesAction() else 0
    return st.dictionaries(shown, data | st.sampled_from(EXPRESSIONS), min_size=least, max_size=2)


def can_be_emptied(place):
    """Whether a transition may empty a place: its tokens are nobody's, and there are never more than some."""
    return place.resource is True and not place.remote and place.capacity is not None and place.capacity < 6


@st.composite
def nets(draw_):
    """Nets of every kind that an author could write."""
    some = draw_(st.lists(names, min_size=3, max_size=6, unique=True))
    place_names, place = st.lists(st.sampled_from(some), max_size=2), st.sampled_from(some)
    arcs = st.dictionaries(place, st.integers(1, 3), max_size=3)
    places = {}
    for name in some:
        tokens, room = draw_(st.integers(0, 3)), draw_(st.none() | st.integers(1, 3))
        data_object = draw_(st.none() | shown)
        on_invalid = tuple(draw_(place_names)) if data_object is not None else ()
        capacity = None if room is None else tokens + room
        remote, resource = draw_(st.booleans()), draw_(st.none() | st.booleans())
        kind, scope = (None, ObjectScope.COMMAND)
        if data_object is not None:
            kind, scope = draw_(st.sampled_from([None, "p/msg/Word"])), draw_(st.sampled_from(ObjectScope))
        places[name] = Place(name, tokens, capacity, data_object, on_invalid, remote, resource, kind, scope)
    escalate = draw_(st.none() | place)
    readings = [(None, None), (ReadFor.COMMAND, None), (ReadFor.NOBODY, 0.0), (None, 2.5)]
    said_of = {symbol: draw_(st.sampled_from(readings)) for symbol in WORDS} | {None: (None, None)}
    transitions = {}
    for name in draw_(st.lists(names, min_size=1, max_size=4, unique=True)):
        inputs = draw_(arcs)
        action = draw_(st.none() | actions)
        on_failure = draw_(arcs) if action else {}
        if action and escalate is None:
            on_failure = on_failure or {some[0]: 1}
        inhibitors = draw_(st.dictionaries(place, st.integers(1, 4), max_size=2))
        symbol = draw_(names) if not inputs else draw_(optional)
        said = said_of[symbol]
        remote = st.builds(RemotePlace, st.sampled_from(["other", "far_away"]), names)
        transitions[name] = Transition(
            name,
            inputs,
            draw_(arcs),
            draw_(st.dictionaries(remote, st.integers(1, 2), max_size=2)),
            {key: weight for key, weight in inhibitors.items() if weight > inputs.get(key, 0)},
            draw_(st.none() | st.builds(Guard, names | st.sampled_from(EXPRESSIONS), st.booleans())),
            symbol,
            tuple(draw_(st.lists(names, max_size=2))),
            action,
            on_failure,
            draw_(arcs) if action else {},
            draw_(st.none() | positive) if action else None,
            draw_(st.none() | delays()),
            draw_(st.floats(0, 1)) if action else 1.0,
            draw_(positive),
            draw_(st.none() | st.builds(Strategy, positive, positive, st.floats(0.01, 1))) if action else None,
            draw_(st.integers(-5, 5)),
            *said,
            origin=name,
            result=draw_(returned(action)),
            acts_on=draw_(acted_on) if action else None,
            servers=draw_(st.sampled_from([None, 1, 2, LARGEST])) if action else None,
            resets=tuple(each for each in some if can_be_emptied(places[each]) and draw_(st.booleans()))[:2],
        )
    services = {}
    if draw_(st.booleans()):
        services["serve"] = Service("serve", *some[:3], draw_(st.none() | schemas()), draw_(acted_on))
    begun = sorted({t.symbol for t in transitions.values() if t.symbol is not None and t.symbol_of is None})
    said = draw_(st.lists(st.sampled_from(begun), unique=True)) if begun else []
    needs = st.lists(shown, max_size=3).map(tuple)
    more = needs, st.sampled_from(Busy), st.integers(-10, 10)
    commands = {symbol: CommandDeclaration(draw_(shown), draw_(schemas()), *map(draw_, more)) for symbol in said}
    rest = draw_(st.none() | place_names.map(tuple))
    name = draw_(st.sampled_from(["n", "Net_2", "yes"]))
    at_once = draw_(st.integers(1, 3)) if services else 1
    net = Net(name, places, transitions, services, escalate, rest, draw_(shown), commands=commands, at_once=at_once)
    sent = sorted({target for t in transitions.values() for target in t.remote_outputs})
    limits = st.integers(1, 5).map(lambda most: Assumption(at_most=most))
    assumed = limits | st.sampled_from(sent).map(lambda target: Assumption(returns=target)) if sent else limits
    wanted = {name: draw_(assumed) for name in [*places, *services] if draw_(st.booleans())}
    return replace(net, assume={n: a for n, a in wanted.items() if not list(faults(replace(net, assume={n: a})))})


def bare(net):
    """A net without where it came from."""
    lines = {name: replace(t, line=0) for name, t in net.transitions.items()}
    return replace(net, source="", transitions=lines)


@settings(max_examples=60, deadline=None)
@given(nets())
def test_a_net_written_as_yaml_is_read_back_the_same(net):
    assert bare(parse_net(yaml_text(net))) == net


@settings(max_examples=60, deadline=None)
@given(nets())
def test_a_net_written_as_pnml_is_read_back_the_same(tmp_path_factory, net):
    file = tmp_path_factory.getbasetemp() / "net.pnml"
    file.write_text(pnml_text(net), encoding="utf-8")
    assert bare(load_net(file)) == net


@settings(max_examples=60, deadline=None)
@given(nets())
def test_what_is_written_has_the_structure_that_the_standard_asks_for(net):
    root = ElementTree.fromstring(pnml_text(net))
    pnml = f"{{{NAMESPACE}}}"
    assert root.tag == f"{pnml}pnml"
    (written,) = root
    assert written.get("type") == "http://www.pnml.org/version-2009/grammar/ptnet"
    pages = written.findall(f"{pnml}page")
    assert pages
    ids = [element.get("id") for element in root.iter() if element.get("id") is not None]
    assert len(set(ids)) == len(ids)
    assert all(NCNAME.fullmatch(each) for each in ids)
    allowed = {"place", "transition", "referencePlace", "arc"}
    places = {place.get("id") for place in root.iter(f"{pnml}place")}
    for page in pages:
        assert {element.tag.removeprefix(pnml) for element in page} <= allowed
        nodes = {element.get("id") for element in page if not element.tag.endswith("arc")}
        for arc in page.findall(f"{pnml}arc"):
            assert {arc.get("source"), arc.get("target")} <= nodes
            assert all(int(text.text) >= 1 for text in arc.iter(f"{pnml}text"))
        for reference in page.findall(f"{pnml}referencePlace"):
            assert reference.get("ref") in places - nodes
    for tool in root.iter(f"{pnml}toolspecific"):
        assert (tool.get("tool"), tool.get("version")) == ("im", "1")
        assert all(not child.tag.startswith(pnml) and json.loads(child.text) is not None for child in tool)


VALIDATOR = jsonschema.Draft202012Validator(json.loads(schema_text()))
CONSISTENCY = (
    "there is no place",
    "has neither input places nor a symbol",
    "both enables and disables",
    "has no transition",
    "no transition sends",
    "of another net; only",
    "of this very net",
    "more than the capacity",
    "must be three different places",
    "can fail: say where",
    "goes from",
    "no transition begins a command",
    "is for numbers; the argument",
    "is for lists and texts; the argument",
    "is less than the minimum",
    "argument ",
    "no place says of what type",
    "something else than transition",
    "is not between low and high",
    "has no finite mean",
    "'places' is missing",
    "'transitions' is missing",
    "may hold what belongs to a command",
    "must have a `capacity`",
    "names a place twice",
    "ways together; at most",
)
"""What a schema cannot say: names that must exist, numbers that depend on others, parts that an include may have."""

JUNK = [None, True, 0, -1, 1, 2.5, "a", "x.y", "x.y.z", "not g", "9", [], ["a"], [[]], {}, {"a": 1}, {"a": 0}]


def containers(value):
    """All mappings and lists in a value."""
    if isinstance(value, dict | list):
        yield value
        for child in value.values() if isinstance(value, dict) else value:
            yield from containers(child)


def damage(data, draw_):
    """Changes, adds or takes away one value, or gives it another key."""
    where = draw_(st.sampled_from([each for each in containers(data) if each]))
    key = draw_(st.sampled_from(list(where) if isinstance(where, dict) else range(len(where))))
    change = draw_(st.sampled_from(["value", "value", "value", "away", "key", "more"]))
    if change == "value":
        where[key] = copy.deepcopy(draw_(st.sampled_from(JUNK)))
    elif change == "away":
        del where[key]
    elif isinstance(where, dict):
        odd = draw_(st.sampled_from(["odd", "a", "tokens", "in", "action", "request", "delay", "9", "SI", "rate"]))
        where[odd] = copy.deepcopy(where[key])
        if change == "key" and key != odd:
            del where[key]


def as_yaml(data):
    """JSON is YAML, but for some characters."""
    return re.sub("[\x7f-\x9f\ud800-\udfff\ufeff\ufffe\uffff]", "?", json.dumps(data, ensure_ascii=False))


@settings(max_examples=60, deadline=None)
@given(nets(), st.integers(0, 2), st.data())
def test_what_the_reader_takes_the_schema_takes_and_the_reverse(net, damages, data):
    written = json.loads(json.dumps(describe(net)))
    for _ in range(damages):
        damage(written, data.draw)
    complaints = [error.message for error in VALIDATOR.iter_errors(written)]
    refused = ""
    try:
        parse_net(as_yaml(written), "x")
    except NetFileError as error:
        refused = error.message
    if complaints:
        assert refused, complaints
    else:
        assert not refused or any(known in refused for known in CONSISTENCY), refused
