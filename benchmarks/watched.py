"""What pages cost the filter that they show: the median step beside one, a killed, a stalled and fifty pages.

    python benchmarks/watched.py [--turns 5] [--steps 400]

A particle filter of 20 000 particles takes a step every 20 ms; pages are sockets of another process that ask for the next moment
as soon as they have the last. In each turn every case is measured once, so that what else the machine does touches all
alike; ratios are medians of turns.
"""

import argparse
import asyncio
import json
import multiprocessing
import os
import signal
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests" / "watch"))

PERIOD = 0.02
CASES = {"none": (0, True), "one page": (1, True), "killed page": (1, True), "stalled page": (1, False), "fifty pages": (50, True)}
"""How many pages, and whether they read what they asked for."""


def pages(address, count, reads):
    """Be so many pages until killed."""
    from looked_at import entered, question
    from websockets.asyncio.client import connect

    port, cookie = entered(SimpleNamespace(address=address))

    async def one():
        async with connect(f"ws://127.0.0.1:{port}/live", origin=f"http://127.0.0.1:{port}", additional_headers={"Cookie": cookie},
                           compression=None, max_size=None) as socket:  # fmt: skip
            known = {}
            while True:
                await socket.send(question(**known))
                if not reads:
                    socket.transport.pause_reading()
                    await asyncio.sleep(3600)
                content = await socket.recv()
                header = json.loads(content[4 : 4 + int.from_bytes(content[:4], "little")])
                rows = header["rows"]
                known |= {"generation": rows["generation"], "rows": rows["from"] + rows["count"], "state": header["state"]}
                if "frame" in header:
                    known["have"] = header["frame"]["number"]

    async def all_of_them():
        await asyncio.gather(*(one() for _ in range(count)))

    asyncio.run(all_of_them())


def seconds_of_steps(stream, ys, page, steps):
    """Take steps at their times; return how long each took."""
    found, due = [], time.perf_counter()
    for y in ys[:steps]:
        due += PERIOD
        began = time.perf_counter()
        stream.predict()
        stream.update(y)
        np.asarray(stream.mean)
        took = time.perf_counter() - began
        found.append(took)
        page.show(seconds=took)
        time.sleep(max(0.0, due - time.perf_counter()))
    return np.array(found)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--steps", type=int, default=400)
    asked = parser.parse_args()
    import motes as mo

    model = mo.textbook.radar_tracking()
    _, ys = mo.simulate(0, model, asked.steps)
    ys = np.asarray(ys)
    stream = mo.stream(1, mo.ParticleFilter(n=20_000, on_collapse="predict"), model)
    stream.update(ys[0])
    page = mo.watch(stream)
    seconds_of_steps(stream, ys, page, 50)
    context, found = multiprocessing.get_context("spawn"), {name: [] for name in CASES}
    for turn in range(asked.turns):
        for name in list(CASES)[turn % 2 :] + list(CASES)[: turn % 2]:
            count, reads = CASES[name]
            child = context.Process(target=pages, args=(page.address, count, reads), daemon=True) if count else None
            if child is not None:
                child.start()
                time.sleep(3)
                if name == "killed page":
                    os.kill(child.pid, signal.SIGKILL)
            found[name].append(np.median(seconds_of_steps(stream, ys, page, asked.steps)))
            if child is not None:
                child.kill()
                child.join()
    plain = np.array(found["none"])
    print(f"load {os.getloadavg()[0]:.1f}; median step without a page {1e3 * np.median(plain):.2f} ms")
    for name, seconds in found.items():
        ratios = np.array(seconds) / plain - 1
        print(f"{name:<14}{100 * np.median(ratios):+6.1f} %   turns {' '.join(f'{100 * ratio:+.1f}' for ratio in ratios)}")
    page.close()


if __name__ == "__main__":
    main()
