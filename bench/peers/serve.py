"""What every peer does: it reads requests, a JSON object a line, and answers each with another.

``{"do": "load", "net": ...}`` makes the net ready, ``{"do": "fire", "firings": n}`` fires it and answers how often it
fired and the CPU time that took. A net is ``{"places": {name: tokens}, "transitions": {name: [inputs, outputs]}}``.
"""

import json
import os
import sys
import time


def serve(load):
    """Answers requests until there are no more.

    Args:
        load: Makes a net ready; returns the function that fires it so many times and returns how often it did.
    """
    stream = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    fire = None
    for line in sys.stdin:
        request = json.loads(line)
        if request["do"] == "load":
            fire = load(request["net"])
            answer = {}
        else:
            began = time.process_time()
            fired = fire(request["firings"])
            answer = {"firings": fired, "cpu_s": time.process_time() - began}
        print(json.dumps(answer), file=stream, flush=True)
