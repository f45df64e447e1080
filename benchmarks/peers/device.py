"""Motes on a device: beside what ours.py does, whether the numbers are the CPU's, and where the time goes. Called by gpu.py."""

import collections
import re
import tempfile
import time
import warnings
import zlib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import motes as mo
from motes.core import random
from motes.resampling.schemes import Systematic
from peers import ours

STAGES = {
    "normal_block": "normal numbers",
    "normal": "normal numbers",
    "boundaries": "cumulative weights",
    "Systematic.at": "ancestors",
    "ancestors_from_ends": "ancestors",
    "Cloud.resampled": "picking",
    "AdditiveGaussian.sample": "moving",
    "AdditiveGaussian.log_prob": "likelihood",
    "AdditiveGaussian.max_log_prob": "likelihood",
    "weigh": "weights",
    "weighted_moments": "mean and covariance",
    "Filter.accept": "settling",
}
"""Functions of the library, as they stand in compiled programs, and what a reader calls their work; inner ones count first."""


def prepare(task, **options):
    """Return the job that a task asks for: "stream" (numbers to compare), "speed" (of memory), "profile", or one of ours."""
    own = {"stream": stream, "speed": speed, "profile": profile}.get(task["kind"])
    return own(task) if own else ours.prepare(task, **options)


def stream(task):
    """Random numbers, ancestors and moments: exact ones as checksums, normal numbers in a file."""
    n = task["n"]

    def job(seed):
        key = random.as_key(seed)
        words = jax.jit(lambda key: random._words(jax.random.key_data(key), (3, n)))(key)
        normals = np.asarray(random.normal(key, (2, n), jnp.float32))
        file = Path(task["folder"]) / f"normals {task['name']}.npy"
        np.save(file, normals)
        log_weights = jax.nn.log_softmax(-0.5 * jnp.asarray(normals[1]) ** 2)
        points = 300 + 5 * jnp.asarray(normals)
        cloud = mo.laws.cloud.Cloud(points, log_weights, jnp.arange(n, dtype=jnp.int32))
        counts = np.bincount(np.asarray(jax.jit(Systematic().ancestors, static_argnums=2)(key, log_weights, n)), minlength=n)
        weights = np.exp(np.asarray(log_weights, np.float64))
        weights /= weights.sum()
        exact = np.asarray(points, np.float64)
        mean = exact @ weights
        cov = ((exact - mean[:, None]) * weights) @ (exact - mean[:, None]).T
        scale = np.sqrt(np.diag(cov))
        return {
            "random words": zlib.crc32(np.stack(words).tobytes()),
            "uniform numbers": zlib.crc32(np.asarray(random.uniform(key, (n,), jnp.float32)).tobytes()),
            "children beyond n w": float(np.max(np.abs(counts - n * weights))),
            "mean, in standard deviations": float(np.max(np.abs(np.asarray(cloud.mean()) - mean) / scale)),
            "covariance, relative": float(np.max(np.abs(np.asarray(cloud.cov()) - cov) / np.outer(scale, scale))),
            "normals": str(file),
        }

    return job


def speed(task):
    """Bytes per second that a large array is read and written at, and what the device is called."""
    x = jnp.ones((6, task["n"]), jnp.float32)
    step = jax.jit(lambda x: x + 1)

    def job(seed):
        step(x).block_until_ready()
        started = time.perf_counter()
        for _ in range(20):
            out = step(x)
        out.block_until_ready()
        device = jax.devices()[0]
        name = f"{device.device_kind}" if device.platform != "cpu" else "CPU"
        return {"bytes": 2 * x.nbytes * 20 / (time.perf_counter() - started), "device": name, "jax": jax.__version__}

    return job


def profile(task):
    """Milliseconds of each stage of a step, and how many kernels it takes, from the profiler."""
    filter = mo.ParticleFilter(n=task["n"], policy=mo.resampling.Always(), on_collapse="predict")
    model, ys = ours.MODELS[task["model"]](), np.asarray(task["ys"], np.float32)
    run = jax.jit(lambda key: mo.run(key, filter, model, ys, keep=mo.keep.nothing).log_likelihood)
    key = random.as_key(0)
    program = run.lower(key).compile()
    program(key).block_until_ready()
    stages = stages_of(program.as_text())

    def job(seed):
        with tempfile.TemporaryDirectory() as folder:
            with jax.profiler.trace(folder):
                program(random.as_key(seed)).block_until_ready()
            path = next(Path(folder).rglob("*.xplane.pb"))
            found = kernels(jax.profiler.ProfileData.from_file(str(path)))
        spent, counts = collections.Counter(), collections.Counter()
        for operation, nanoseconds in found:
            stage = stages.get(operation, "everything else")
            spent[stage] += nanoseconds / 1e6 / len(ys)
            counts[stage] += 1 / len(ys)
        return [(stage, spent[stage], counts[stage]) for stage, _ in spent.most_common()]

    return job


def kernels(data):
    """Yield the operation and the nanoseconds of each kernel of a profile; on a CPU, of each thunk."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        for plane in data.planes:
            for line in plane.lines:
                for event in line.events:
                    operation = dict(event.stats).get("hlo_op")
                    # loops and branches last as long as what is in them
                    if operation and not operation.startswith(("while", "conditional", "call")):
                        yield operation, event.duration_ns


def stages_of(text):
    """Tell for each operation of a compiled program whose work it does: a stage, or "a + b" where each has a quarter of its lines."""
    functions = frames(text)
    inside, calls, computation = collections.defaultdict(collections.Counter), {}, ""
    for line in text.splitlines():
        opened = re.match(r"^(?:ENTRY )?%?([\w.\-]+) \(.*\{$", line)
        computation = opened.group(1) if opened else computation
        operation = re.match(r"^\s+(?:ROOT )?%?([\w.\-]+) = ", line)
        frame = re.search(r"stack_frame_id=(\d+)", line)
        if not operation:
            continue
        stage = functions.get(frame.group(1)) if frame else None
        if stage:
            inside[operation.group(1)][stage] += 1
            inside[computation][stage] += 1
        called = re.search(r"calls=%?([\w.\-]+)", line)
        calls[operation.group(1)] = called.group(1) if called else operation.group(1)
    order = list(dict.fromkeys(STAGES.values()))
    found = {}
    for operation, place in calls.items():
        within = inside[place] or inside[operation]
        held = [stage for stage in order if 4 * within[stage] >= max(sum(within.values()), 1)]
        found[operation] = " + ".join(held or [stage for stage, _ in within.most_common(1)])
    return {operation: stage for operation, stage in found.items() if stage}


def frames(text):
    """Return the stage of each stack frame: that of the innermost function that has one."""
    tables = {}
    for title in ("FunctionNames", "FileLocations", "StackFrames"):
        block = re.search(rf"^{title}\n((?:\d+ .*\n)+)", text, re.MULTILINE)
        tables[title] = dict(line.split(" ", 1) for line in block.group(1).splitlines()) if block else {}
    names = {number: name.strip('"') for number, name in tables["FunctionNames"].items()}
    places = {number: re.search(r"function_name_id=(\d+)", place).group(1) for number, place in tables["FileLocations"].items()}
    chain = {}
    for number, frame in tables["StackFrames"].items():
        place, parent = re.search(r"file_location_id=(\d+)", frame), re.search(r"parent_frame_id=(\d+)", frame)
        # parents are printed one too high, 1 for none
        chain[number] = (names[places[place.group(1)]], str(int(parent.group(1)) - 1))
    found = {}
    for number in chain:
        at = number
        while at in chain and chain[at][0] not in STAGES:
            at = chain[at][1]
        found[number] = STAGES.get(chain[at][0]) if at in chain else None
    return found
