"""Runs engines in turns: each in a process of its own that is kept alive, and never two at work at once."""

import json
import os
import select
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
LIMIT = 60.0
"""Seconds that one timing may take; the first, cold one twice that."""


class Worker:
    """One engine's process."""

    def __init__(self, python, module, environment):
        """Start it."""
        # an empty value lets Python keep what it compiles, as it does unless told otherwise: that decides how long a process takes to start
        usual = {"JAX_PLATFORMS": "cpu", "TF_CPP_MIN_LOG_LEVEL": "3", "PYTHONDONTWRITEBYTECODE": ""}
        variables = os.environ | usual | environment
        command = [python, str(HERE / "worker.py"), module]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        self.process = subprocess.Popen(command, env=variables, cwd=HERE, **pipes)

    def ask(self, order, limit):
        """Give an order and wait for the answer; a worker that is too late or dies is ended, and the answer says so."""
        try:
            self.process.stdin.write(json.dumps(order).encode() + b"\n")
            self.process.stdin.flush()
            if not select.select([self.process.stdout], [], [], limit)[0]:
                self.end()
                return {"failed": f"took more than {limit:.0f} s"}
            line = self.process.stdout.readline()
        except BrokenPipeError:
            line = b""
        return json.loads(line) if line else {"failed": "its process died"}

    def end(self):
        """End the process."""
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()


def progress(text):
    print(text, file=sys.stderr, flush=True)


def compete(engines, task, repeats, budget):
    """Time engines on one task, in turns.

    Args:
        engines: name -> (worker, options).
        task: file that holds the task.
        repeats: how often each runs.
        budget: seconds after which an engine is not repeated any more.

    Returns:
        name -> record of `first` (seconds of the cold run), `seconds`, `values` (log likelihoods), or `failed` (the reason).
    """
    found = {}
    for name, (worker, options) in engines.items():
        reply = worker.ask({"do": "prepare", "task": str(task), "options": options}, 2 * LIMIT)
        found[name] = {"failed": reply["failed"]} if "failed" in reply else {"first": reply["seconds"], "seconds": [], "values": []}
    for turn in range(1, repeats + 1):
        for name, (worker, _) in engines.items():
            record = found[name]
            if "failed" in record or sum(record["seconds"]) > budget:
                continue
            time.sleep(0.02)  # threads of the engine before may still spin for a moment
            reply = worker.ask({"do": "run", "seed": turn}, LIMIT)
            if "failed" in reply and not record["seconds"]:
                record["failed"] = reply["failed"]
            elif "failed" not in reply:
                record["seconds"].append(reply["seconds"])
                record["values"].append(reply["value"])
    return found


def start_up(python, engine, task, settings):
    """Time a fresh process from its start to the end of its first run, and then a run on a model built anew; seconds, or a reason."""
    started = time.perf_counter()
    worker = Worker(python, engine.module, engine.environment | settings)
    order = {"do": "prepare", "task": str(task), "options": engine.options}
    try:
        reply = worker.ask(order, 2 * LIMIT)
        seconds = time.perf_counter() - started
        again = worker.ask(order, 2 * LIMIT) if "failed" not in reply else reply
    finally:
        worker.end()
    return again["failed"] if "failed" in again else (seconds, again["seconds"])
