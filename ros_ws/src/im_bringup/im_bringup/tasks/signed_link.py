"""Messages between the bootstrap and the agent of another host: readable by all participants, forgeable by none.

Each message is signed with a secret that the hosts share. It names the present incarnations of its sender and of its
receiver, and has a number: a recorded message, of this run or of a former one, is not taken a second time.
"""

import hmac
import json
import os
import secrets
import stat
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from im_bringup.tasks.deployment import agent_name
from im_core.errors import ConfigError, DataError
from im_core.files import FileError, read_bytes
from im_core.processes.agent_socket import AgentOrder, TaskReport
from im_core.text.bounded_json import read_json

#: Names the file of the secret; the default is the second, in the user's folder of configurations.
VARIABLE, _DEFAULT = "IM_SECRET_FILE", "im/secret"
_SHORTEST, _LARGEST = 32, 4096
_DIGEST = "sha256"


@dataclass(frozen=True)
class _Message:
    sender: str
    receiver: str
    number: int
    content: str


@dataclass(frozen=True)
class HostOrder:
    """Order of the bootstrap to the agent of another host.

    Attributes:
        order: What its tasks are to do; None: report first what the host has.
        start_timeout_s: How long the start may take [s].
        options: What the start was given, as of :func:`im_bringup.tasks.deployment.options_text`.
        run: Name of this run of the machine.
    """

    order: AgentOrder | None
    start_timeout_s: float
    options: str
    run: str


@dataclass(frozen=True)
class HostReport:
    """Report of an agent to the bootstrap.

    Attributes:
        tasks: The reports of its tasks, each with its process.
        digests: Of what the host has, as of :func:`im_bringup.tasks.host_digest.digests`.
        serves: Name of the run of the agent; empty before the first order.
    """

    tasks: list[tuple[TaskReport, int]]
    digests: dict[str, str]
    serves: str = ""


def orders_topic(host: str) -> str:
    """Return the topic for orders of the bootstrap to the agent of a host, as :class:`HostOrder`."""
    return f"/{agent_name(host)}/orders"


def reports_topic(host: str) -> str:
    """The topic on which the agent of a host tells the bootstrap :class:`HostReport`."""
    return f"/{agent_name(host)}/reports"


@dataclass(frozen=True)
class Opened:
    """A message with a right signature.

    Attributes:
        sender: The incarnation of its sender.
        content: What it says; None if it was made for another incarnation, has been taken before, or was refused.
        refused: Whether it is of a new incarnation that may not take the place of the present one.
    """

    sender: str
    content: str | None
    refused: bool = False


def read_secret(environ: Mapping[str, str]) -> bytes:
    """Read the secret shared by the hosts of a machine.

    Raises:
        ConfigError: There is none, others may read it, or it is too short to be one.
    """
    folder = environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")
    path = Path(environ.get(VARIABLE) or Path(folder) / _DEFAULT)
    make = f"make one with (umask 077; openssl rand -hex 32 > {path}) and copy it to all hosts of the deployment"
    try:
        secret = read_bytes(path, _LARGEST).strip()
        status = path.stat()
    except (FileError, OSError) as error:
        raise ConfigError(f"the secret of the machine's hosts, {error}; {make}", file=str(path)) from error
    if status.st_uid != os.geteuid() or stat.S_IMODE(status.st_mode) & 0o077:
        raise ConfigError(f"{path} must belong to you and be of mode 0600: it is the secret of the machine's hosts")
    if len(secret) < _SHORTEST:
        raise ConfigError(f"{path} has {len(secret)} characters, a secret at least {_SHORTEST}; {make}")
    return secret


class SignedLink:
    """One end of a link between bootstrap and agent.

    Attributes:
        peer: The present incarnation of the other end; empty before it is known.
    """

    def __init__(self, secret: bytes, host: str) -> None:
        self._secret, self._host = secret, host
        self._incarnation = secrets.token_hex(16)
        self._sent = self._taken = 0
        self.peer = ""
        self._peers: set[str] = set()

    def sign(self, topic: str, content: str, receiver: str | None = None) -> str:
        """Make a message.

        Args:
            topic: On which it is sent.
            content: What it says.
            receiver: For which incarnation of the other end; None: the present one.
        """
        self._sent += 1
        message = _Message(self._incarnation, self.peer if receiver is None else receiver, self._sent, content)
        text = json.dumps(asdict(message))
        return self._signature(topic, text) + text

    def open(self, topic: str, signed: str, accepts: Callable[[str], bool] = lambda _: True) -> Opened:
        """Read a message.

        Args:
            topic: The topic of the message.
            signed: The message.
            accepts: Decides by the content of a message whether a new incarnation of the other end may take the place
                of the present one.

        Raises:
            DataError: It is not signed with the secret, for this topic and host.
        """
        size = 2 * hmac.new(self._secret, digestmod=_DIGEST).digest_size
        signature, text = signed[:size], signed[size:]
        if not hmac.compare_digest(_encoded(signature), self._signature(topic, text).encode()):
            raise DataError(f"a message on {topic} for host {self._host} is not signed with the secret of {VARIABLE}")
        message = read_json(_Message, text, f"a message on {topic}")
        if self._is_new(message) and not accepts(message.content):
            return Opened(message.sender, None, refused=True)
        return Opened(message.sender, message.content if self._is_fresh(message) else None)

    def _is_new(self, message: _Message) -> bool:
        return message.receiver == self._incarnation and message.sender not in self._peers

    def _is_fresh(self, message: _Message) -> bool:
        """Return whether a message is new and for this incarnation; a new one of the other end ends the former."""
        if message.receiver != self._incarnation:
            return False
        if self._is_new(message):
            self._peers.add(message.sender)
            self.peer, self._taken = message.sender, 0
        if message.sender != self.peer or message.number <= self._taken:
            return False
        self._taken = message.number
        return True

    def _signature(self, topic: str, text: str) -> str:
        return hmac.new(self._secret, _encoded(f"{topic} {self._host} {text}"), _DIGEST).hexdigest()


def _encoded(text: str) -> bytes:
    return text.encode(errors="replace")
