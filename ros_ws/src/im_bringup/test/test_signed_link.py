import os

import pytest

from im_bringup.tasks.signed_link import VARIABLE, SignedLink, read_secret
from im_core.errors import ConfigError, DataError

SECRET = b"thirty-two characters at the least"


@pytest.fixture
def ends():
    """Both ends of a link that have heard of each other, and all that the second one has said until then."""
    bootstrap, agent = SignedLink(SECRET, "far"), SignedLink(SECRET, "far")
    greeting = agent.sign("reports", "who is there?")
    asked = bootstrap.open("reports", greeting)
    assert asked.content is None  # made for nobody: it may be an old one
    answer = bootstrap.sign("orders", "load", asked.sender)
    assert agent.open("orders", answer).content == "load"
    report = agent.sign("reports", "loaded")
    assert bootstrap.open("reports", report).content == "loaded"
    return bootstrap, agent, [greeting, report]


def test_what_is_signed_for_this_life_is_taken_once(ends):
    bootstrap, agent, said = ends
    for old in said:
        assert bootstrap.open("reports", old).content is None
    late, newest = agent.sign("reports", "1"), agent.sign("reports", "2")
    assert bootstrap.open("reports", newest).content == "2"
    assert bootstrap.open("reports", late).content is None


def test_nothing_is_taken_that_others_made_or_that_was_made_for_others(ends):
    bootstrap, agent, _ = ends
    for signed in (
        "",
        "no signature",
        "\udcff" * 64,
        SignedLink(b"another secret of thirty characters", "far").sign("reports", "failed", "x"),
        SignedLink(SECRET, "near").sign("reports", "failed", "x"),
        bootstrap.sign("orders", "sent back"),
        agent.sign("reports", "loaded").replace("loaded", "failed"),
    ):
        with pytest.raises(DataError, match="a message on reports for host far is not signed with the secret"):
            bootstrap.open("reports", signed)


def test_messages_of_a_former_run_are_not_taken_by_the_next(ends):
    bootstrap, _, said = ends
    order = bootstrap.sign("orders", "shut down")
    next_agent, next_bootstrap = SignedLink(SECRET, "far"), SignedLink(SECRET, "far")
    assert next_agent.open("orders", order).content is None
    assert [next_bootstrap.open("reports", old).content for old in said] == [None, None]


def test_a_new_life_of_an_end_is_heard_and_its_former_is_not_any_more(ends):
    bootstrap, agent, _ = ends
    late, again = agent.sign("reports", "failed"), SignedLink(SECRET, "far")
    answer = bootstrap.sign("orders", "start", bootstrap.open("reports", again.sign("reports", "?")).sender)
    assert again.open("orders", answer).content == "start"
    assert bootstrap.open("reports", again.sign("reports", "ready")).content == "ready"
    assert bootstrap.open("reports", late).content is None
    assert bootstrap.open("reports", again.sign("reports", "still ready")).content == "still ready"


def test_a_new_bootstrap_that_is_refused_changes_nothing_until_it_is_accepted(ends):
    bootstrap, agent, _ = ends
    other = SignedLink(SECRET, "far")
    sender = other.open("reports", agent.sign("reports", "?")).sender
    order = other.sign("orders", "load", sender)
    refused = agent.open("orders", order, lambda content: content != "load")
    assert (refused.content, refused.refused) == (None, True)
    assert agent.peer != refused.sender
    assert agent.open("orders", bootstrap.sign("orders", "configure"), lambda _: False).content == "configure"
    assert agent.open("orders", order).content == "load"
    assert agent.peer == refused.sender


def test_the_secret_is_of_its_owner_alone(tmp_path):
    path = tmp_path / "secret"
    environ = {VARIABLE: str(path)}
    with pytest.raises(ConfigError, match=r"secret: cannot be read.*openssl rand -hex 32"):
        read_secret(environ)
    path.write_bytes(SECRET + b"\n")
    path.chmod(0o640)
    with pytest.raises(ConfigError, match=f"{path} must belong to you and be of mode 0600"):
        read_secret(environ)
    path.chmod(0o600)
    assert read_secret(environ) == SECRET
    path.write_bytes(b"short")
    with pytest.raises(ConfigError, match="has 5 characters, a secret at least 32"):
        read_secret(environ)
    (tmp_path / "im").mkdir()
    os.rename(path, tmp_path / "im" / "secret")
    (tmp_path / "im" / "secret").write_bytes(SECRET)
    assert read_secret({"XDG_CONFIG_HOME": str(tmp_path)}) == SECRET
