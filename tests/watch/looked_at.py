"""A small stream with its page, and raw requests to that."""

import json
import re
import socket

import jax.numpy as jnp
import numpy as np

import motes as mo

NAMES = ("east", "north", "speed")


def small_model(names=NAMES):
    size = len(names)
    walk = mo.LinearGaussian(jnp.eye(size), 0.01 * jnp.eye(size))
    sensor = mo.LinearGaussian(jnp.eye(min(2, size), size), 0.1 * jnp.eye(min(2, size)))
    return mo.StateSpaceModel(mo.Gaussian(jnp.zeros(size), jnp.eye(size)), walk, sensor, names=names)


def small_stream(n=200, names=NAMES):
    return mo.stream(0, mo.ParticleFilter(n=n), small_model(names))


def stepped(stream, page, steps, value=0.0):
    size = min(2, stream.model.size)
    for _ in range(steps):
        if stream.held is not None:
            stream.predict()
        stream.update(np.full(size, value, np.float32))
        page.show(seconds=1e-3, time=float(stream.t))


def asked(port, request):
    """Send bytes, and return what comes until the other side is silent or gone."""
    with socket.create_connection(("127.0.0.1", port), timeout=10) as line:
        line.sendall(request)
        line.settimeout(10)
        found = b""
        try:
            while piece := line.recv(65536):
                found += piece
                if _is_whole(found):
                    break
        except TimeoutError:
            pass
        return found


def _is_whole(found):
    head, _, body = found.partition(b"\r\n\r\n")
    if head.startswith(b"HTTP/1.1 101"):
        return True
    size = re.search(rb"content-length: (\d+)", head.lower())
    return size is not None and len(body) >= int(size[1])


def get(port, path="/", host=None, **headers):
    """Return status and the whole of an answer."""
    lines = [f"GET {path} HTTP/1.1", f"Host: {host or f'127.0.0.1:{port}'}", "Connection: close"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    found = asked(port, "\r\n".join([*lines, "", ""]).encode())
    return int(found.split()[1]) if found else 0, found.decode("latin-1")


def upgraded(port, host=None, path="/live", **headers):
    """Ask for a socket; return the status, 101 where it was accepted."""
    more = {"Upgrade": "websocket", "Sec_WebSocket_Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec_WebSocket_Version": "13", **headers}
    lines = [f"GET {path} HTTP/1.1", f"Host: {host or f'127.0.0.1:{port}'}", "Connection: Upgrade"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in more.items()]
    found = asked(port, "\r\n".join([*lines, "", ""]).encode())
    return int(found.split()[1]) if found else 0


def entered(page):
    """Return port and cookie of a page, for who has its link."""
    port, token = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/\?token=(\S+)", page.address).groups()
    status, answer = get(int(port), f"/?token={token}")
    assert status == 200
    return int(port), re.search(r"set-cookie: (motes_\d+=[^;]+)", answer)[1]


def connected(port, cookie, **options):
    from websockets.sync.client import connect

    return connect(f"ws://127.0.0.1:{port}/live", origin=f"http://127.0.0.1:{port}", additional_headers={"Cookie": cookie},
                   compression=None, max_size=None, **options)  # fmt: skip


def question(**changes):
    return json.dumps({"axes": [0, 1], "have": -1, "at": None, "by": 0, "generation": -1, "rows": 0, "state": "", **changes})


def answer(content, width):
    """Take an answer apart: header, rows, and the moment's x, y and weights as numbers."""
    length = int.from_bytes(content[:4], "little")
    header = json.loads(content[4 : 4 + length])
    begin = 4 + length
    many = header["rows"]["count"] * width
    rows = np.frombuffer(content, "<f8", many, begin).reshape(-1, width)
    frame = header.get("frame")
    if frame is None:
        return header, rows, None
    return header, rows, points_of(frame, content, begin + 8 * many)


def points_of(header, content, begin=0):
    """Read x, y and weights of a moment as a page does, from where they begin."""
    count = header["count"]
    xy = np.frombuffer(content, "<u2", 2 * count, begin).reshape(2, count)
    low, high = np.array(header["low"])[:, None], np.array(header["high"])[:, None]
    return low + xy / 65535 * (high - low), np.frombuffer(content, np.uint8, count, begin + 4 * count)
