"""Mutated files: 200 for each reader by day, 20 000 by night; each is read within 20 s, or refused in one line."""

import gzip
import json
import sys
import time
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy.io

import motes as mo
from motes.core.checks import MotesError, MotesWarning
from motes.io.recordings import read_plaza
from motes.io.tables import read_table
from motes.studies.store import LEDGER, Store
from tiers import NIGHT

sys.path.insert(0, str(Path(__file__).parents[1] / "io"))
from raster_files import HEIGHTS, dted, geotiff, npz  # noqa: E402

from motes.io.rasters import read_raster  # noqa: E402

MUTATIONS = 20_000 if NIGHT else 200
SLOWEST = 20.0


# mutations -----------------------------------------------------------------------------------------------------------


def small_plaza(folder):
    t = np.arange(40) / 5
    truth = np.column_stack([t, t, 0 * t, 0 * t])
    beacons = np.array([[1, 0, 9.0], [2, 9, 0]])
    ranges = np.column_stack([t[:-1] + 0.01, t[:-1], np.tile([1.0, 2], 20)[:39], 9 + t[:-1]])
    parts = {"GT": truth, "DR": np.column_stack([t[1:], 0.2 + 0 * t[1:], 0 * t[1:]]), "DRp": truth, "TD": ranges, "TL": beacons}
    scipy.io.savemat(folder / "a.mat", parts, do_compression=True)
    return folder / "a.mat"


def table(folder, data, name="a.csv"):
    (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    return folder / name


def small_json(folder):
    rows = [{"t": f"2020-01-01T00:00:{i:02}", "a": i / 7, "b": None if i % 5 else i} for i in range(30)]
    return table(folder, json.dumps(rows), "a.json")


def small_parquet(folder):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    columns = {"t": arrow.array(range(30), arrow.timestamp("ms")), "a": np.arange(30) / 7, "b": ["3"] * 30}
    parquet.write_table(arrow.table(columns), folder / "a.parquet", write_page_checksum=True)
    return folder / "a.parquet"


def small_zip(folder):
    with zipfile.ZipFile(folder / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("N44E005.hgt", np.full(1201 * 1201, 9, ">i2").tobytes())
    return folder / "a.zip"


def small_toml(folder):
    text = ('application = "terrain"\nseed = 3\nout = "x"\n[map]\nfiles = ["a.npz"]\n[filter]\nkind = "marginalized"\nn = 20\n'
            'linear = ["rD"]\n[study]\nruns = 3\n[noises]\naltimeter = 2.5\n')  # fmt: skip
    return table(folder, text, "a.toml")


def small_history(folder):
    law = mo.Gaussian([0.0], [[1.0]])
    model = mo.StateSpaceModel(law, mo.LinearGaussian([[0.9]], [[1.0]]), mo.LinearGaussian([[1.0]], [[0.5]]))
    return mo.run(0, mo.KalmanFilter(), model, np.ones((3, 1))).save(folder / "a.npz")


def small_picture(folder):
    return geotiff(folder / "a.tif", np.tile(HEIGHTS, (4, 4)), tiled=True, blockxsize=16, blockysize=16, compress="lzw")


def small_ledger(folder):
    with Store(folder / "store"):
        pass
    return folder / "store" / LEDGER


def settings(path):
    from motes.cli.asked import Run, asked

    return asked(Run, [str(path)], "motes run").chosen("filter", "filters")


def tables(path):
    found = read_table(path)
    assert not any(np.isinf(column).any() for column in found.values())


def heights(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MotesWarning)
        assert np.isfinite(read_raster(path).heights).any()


READERS = {
    "DTED": (lambda d: dted(d / "a.dt0", np.ones((21, 21), int), interval=(1800, 1800)), heights),
    "GeoTIFF": (lambda d: geotiff(d / "a.tif"), heights),
    "packed GeoTIFF": (small_picture, heights),
    "npz map": (lambda d: npz(d / "a.npz"), heights),
    "zipped HGT": (small_zip, heights),
    "CSV": (lambda d: table(d, "#x\nt,a,b\n" + "".join(f'2020-01-01T00:00:{i:02},{i / 7},"{-i}"\n' for i in range(30))), tables),
    "JSON": (small_json, tables),
    "gzip": (lambda d: table(d, gzip.compress(small_json(d).read_bytes()), "a.json.gz"), tables),
    "Parquet": (small_parquet, tables),
    "MATLAB": (small_plaza, read_plaza),
    "TOML": (small_toml, settings),
    "history": (small_history, mo.History.load),
    "ledger": (small_ledger, lambda path: Store(path.parent, write=False).__exit__()),
}


def mutated(good, draw):
    """Change some bytes, more of them among the first; swap, repeat or take out a piece; cut the end off."""
    data = bytearray(good)
    limit = len(data) if draw.random() < 0.5 else min(len(data), 800)
    kind = draw.random()
    if kind < 0.6:
        for at in draw.integers(limit, size=draw.integers(1, 5)):
            data[at] = draw.integers(256) if draw.random() < 0.7 else data[at] ^ (1 << int(draw.integers(8)))
    else:
        start, length = int(draw.integers(limit)), int(draw.integers(1, 64))
        piece = data[start : start + length]
        if kind < 0.75:
            del data[start : start + length]
        elif kind < 0.9:
            data[start:start] = piece
        else:
            at = int(draw.integers(limit))
            data[at : at + len(piece)] = piece
    return bytes(data[: len(data) if draw.random() < 0.85 else int(draw.integers(len(data) + 1))])


@pytest.mark.parametrize("name", READERS)
def test_mutated_files_are_read_or_refused_in_one_line(name, tmp_path, capfd):
    make, read = READERS[name]
    path = make(tmp_path)
    good, draw, refusals = path.read_bytes(), np.random.default_rng(40), 0
    read(path)
    for _ in range(MUTATIONS):
        path.write_bytes(mutated(good, draw))
        began = time.monotonic()
        try:
            read(path)
        except MotesError as error:
            refusals += 1
            assert str(error).isprintable() and len(str(error)) <= 500
        assert time.monotonic() - began < SLOWEST
    assert refusals > MUTATIONS / 10
    assert "Traceback" not in capfd.readouterr().err


def test_a_reader_that_lets_errors_through_would_be_found(tmp_path):
    """The planted twin: JSON read without the guard raises what its library raises."""
    path = small_json(tmp_path)
    good, draw = path.read_bytes(), np.random.default_rng(40)
    with pytest.raises(ValueError) as error:
        for _ in range(200):
            path.write_bytes(mutated(good, draw))
            json.loads(path.read_bytes())
    assert not isinstance(error.value, MotesError)
