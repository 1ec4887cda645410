"""Mistakes in any field of mcs.yaml: one sentence with file, line and field, and no other error."""

import copy
import math
import re

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.config import field_name
from im_core.errors import ConfigError
from im_mcs.limits.configuration import McsConfig, load_config
from support.mcs_config import mcs_text

TEXT = mcs_text()
WHOLE = yaml.safe_load(TEXT)


def places(node, at=()):
    """Where every value of a file is."""
    if at:
        yield at
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        yield from places(value, (*at, key))


def within(node, at):
    for key in at:
        node = node[key]
    return node


PLACES = list(places(WHOLE))
TABLES = [at for at in PLACES if isinstance(within(WHOLE, at), dict)]
FREE = ("parameters", "laws")
"""Below these a plug-in's own parameters stand, which the plug-in checks."""
WRONG = st.sampled_from(
    [None, True, "x", "", -1, 0, math.nan, math.inf, -1e308, 10**400, 1e-320, [], {}, [1], {"a": 1}, "ä" * 50]
)


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    path = tmp_path_factory.mktemp("fuzz") / "mcs.yaml"

    def call(text):
        path.write_text(text, encoding="utf-8")
        return load_config(path)

    return call


def dump(data):
    return yaml.dump(data, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper), sort_keys=False)


def refused(load, data):
    """Why a configuration is refused, checked to be one line a fault; empty if it is none."""
    try:
        config = load(dump(data))
    except ConfigError as error:
        message = error.message
    else:
        assert isinstance(config, McsConfig)
        return ""
    for line in message.splitlines():
        assert re.match(r"\S+mcs\.yaml:\d+: [\w.:\[\]]+: .+", line), line
    return message


@settings(max_examples=70, deadline=None)
@given(st.sampled_from(PLACES), WRONG)
def test_a_wrong_value_is_refused_or_harmless(load, at, value):
    data = copy.deepcopy(WHOLE)
    within(data, at[:-1])[at[-1]] = value
    refused(load, data)


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(PLACES))
def test_a_missing_value_is_named_or_has_a_default(load, at):
    data = copy.deepcopy(WHOLE)
    del within(data, at[:-1])[at[-1]]
    message = refused(load, data)
    if message and isinstance(at[-1], str) and at[:1] != ("presets",):
        assert at[-1] in message or field_name(at[:-1]) in message


@settings(max_examples=15, deadline=None)
@given(st.sampled_from([at for at in TABLES if not set(at) & set(FREE) and at != ("presets",)]))
def test_an_unknown_key_is_named(load, at):
    data = copy.deepcopy(WHOLE)
    within(data, at)["zzz"] = 1
    assert "zzz" in refused(load, data)


@pytest.mark.parametrize(
    ("line", "field"),
    [
        ("preset: 2x9", "preset"),
        ("  period_s: 0.0045", "servo.period_s"),
        ("  velocity: 0.95", "limits.velocity"),
        ("    bandwidth_rad_s: 60.0", "control.parameters.bandwidth_rad_s"),
    ],
)
def test_a_key_that_is_given_twice_is_named(load, line, field):
    assert line in TEXT
    with pytest.raises(ConfigError, match=rf"mcs.yaml:\d+: {field}: given twice"):
        load(TEXT.replace(line, f"{line}\n{line}", 1))


@settings(max_examples=40, deadline=None)
@given(st.text(max_size=40) | st.binary(max_size=40))
def test_what_is_no_configuration_at_all_is_said(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "mcs.yaml"
    path.write_bytes(content.encode(errors="surrogatepass") if isinstance(content, str) else content)
    with pytest.raises(ConfigError, match=r"mcs\.yaml"):
        load_config(path)
