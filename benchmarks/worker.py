"""A process that holds one engine: reads orders as lines of JSON and answers with seconds and log likelihoods."""

import gc
import importlib
import json
import os
import sys
import time
from pathlib import Path

from peers import Unavailable


def answer(order, module, held):
    """Carry out one order: prepare (which runs once, cold), or run."""
    started = time.perf_counter()
    if order["do"] == "prepare":
        held["job"] = importlib.import_module(f"peers.{module}").prepare(json.loads(Path(order["task"]).read_text()), **order["options"])
        seed = 0
    else:
        gc.collect()
        seed, started = order["seed"], time.perf_counter()
    value = held["job"](seed)
    return {"seconds": time.perf_counter() - started, "value": value}


def main(module):
    # what libraries print must not get between the answers
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    held = {}
    for line in sys.stdin:
        try:
            reply = answer(json.loads(line), module, held)
        except (Unavailable, ImportError) as reason:
            reply = {"failed": str(reason)}
        except Exception as error:  # noqa: BLE001 - whatever a library raises is its result here
            reply = {"failed": f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"[:200]}
        print(json.dumps(reply), file=answers, flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
