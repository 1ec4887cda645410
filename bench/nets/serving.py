"""What a process that measures does: it reads requests, a JSON object a line, and answers each with another."""

import json
import os
import sys
from collections.abc import Callable, Mapping

Handler = Callable[[dict[str, object]], dict[str, object]]


def answers() -> Callable[[dict[str, object]], None]:
    """Takes the standard output for answers alone; whatever else is printed goes to the standard error.

    Returns:
        Writes an answer; from one thread at a time.
    """
    stream = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())

    def answer(content: dict[str, object]) -> None:
        print(json.dumps(content), file=stream, flush=True)

    return answer


def serve(handlers: Mapping[str, Handler]) -> None:
    """Answers requests until there are no more.

    Args:
        handlers: For each value of ``do`` what answers it.
    """
    answer = answers()
    for line in sys.stdin:
        request = json.loads(line)
        answer(handlers[request["do"]](request))
