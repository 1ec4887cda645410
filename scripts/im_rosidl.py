"""Spares the generators of message code what they do over again: half of their time, and then half of the rest.

Six generators parse every interface, each for itself, and read the same templates for every interface anew.
``underlay.py`` puts this module into the environment with the ROS wheels, and has ``rosidl_parser`` and
``rosidl_pycommon`` use it. What is generated stays the same to the byte.
"""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

TREES = "IM_IDL_TREES"
"""Environment variable: folder for the parsed interfaces. Without it each generator parses."""


def parsed_once(parse: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap ``rosidl_parser.parser.parse_idl_string``: a text that was parsed before is read back.

    Each caller gets a tree of its own, as generators change theirs. Several generators may run at once.
    """

    def parse_idl_string(idl_string: str, png_file: str | None = None) -> Any:
        folder = os.environ.get(TREES)
        if not folder or png_file:
            return parse(idl_string, png_file)
        path = Path(folder) / f"{hashlib.sha256(idl_string.encode()).hexdigest()}.pickle"
        if path.exists():
            return pickle.loads(path.read_bytes())
        content = parse(idl_string)
        path.parent.mkdir(parents=True, exist_ok=True)
        new = path.with_suffix(f".{os.getpid()}")
        new.write_bytes(pickle.dumps(content))
        new.replace(path)
        return content

    return parse_idl_string


def read_templates_once(em: Any) -> None:
    """Let the interpreter of ``em`` (empy 3) keep the tokens of a text that it has run to its end.

    Args:
        em: The module; tokens hold no state of a run.
    """
    plain = em.Interpreter.parse
    kept: dict[tuple[str, str], list[Any]] = {}

    class Recorder:
        """The scanner, remembering what it gave."""

        def __init__(self, scanner: Any):
            self.scanner, self.tokens, self.text = scanner, [], (scanner.prefix, scanner.rest())

        def one(self) -> Any:
            token = self.scanner.one()
            if token is None:
                kept[self.text] = self.tokens
            else:
                self.tokens.append(token)
            return token

    def parse(interpreter: Any, scanner: Any, locals: dict[str, Any] | None = None) -> None:
        tokens = kept.get((scanner.prefix, scanner.rest()))
        if tokens is None:
            plain(interpreter, Recorder(scanner), locals)
            return
        scanner.set("")
        for token in tokens:
            token.run(interpreter, locals)

    em.Interpreter.parse = parse
