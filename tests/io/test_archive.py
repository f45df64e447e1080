"""Saved results: what a file says of its arrays is checked before memory is taken for them."""

import contextlib
import io
import json
import tracemalloc
import zipfile
import zlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import motes as mo
from data import refused
from motes import mcmc
from motes.io import members
from motes.io.archive import agree, read_tree, repeats, write_tree
from motes.io.rasters import read_raster

TREE = {"a": np.arange(6.0).reshape(2, 3), "b": {"c": np.array([True, False]), "d": np.array(3)}}


def doctored(path, **changes):
    """Replace arrays (None leaves one out) and make the checksums fit again."""
    with zipfile.ZipFile(path) as old:
        content = {name: old.read(name) for name in old.namelist()}
    header = json.loads(content["header.json"])
    for name, array in changes.items():
        name = name.replace("__", "/")
        content.pop(f"{name}.npy", None)
        header["crc32"].pop(name, None)
        if array is not None:
            array = np.asarray(array)
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, array, allow_pickle=False)
            content[f"{name}.npy"] = buffer.getvalue()
            header["crc32"][name] = zlib.crc32(np.ascontiguousarray(array).tobytes())
    content["header.json"] = json.dumps(header).encode()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name, data in content.items():
            new.writestr(name, data)
    return path


@pytest.fixture
def file(tmp_path):
    return write_tree(tmp_path / "tree.npz", TREE, {"word": "yes"}, "tree")


def test_what_was_written_comes_back(file):
    tree, texts = read_tree(file, "tree")
    assert texts == {"word": "yes"} and np.array_equal(tree["a"], TREE["a"]) and tree["b"]["d"].shape == () and tree["b"]["c"].dtype == bool


def test_arrays_of_another_byte_order_are_turned(file):
    tree, _ = read_tree(doctored(file, a=TREE["a"].astype(">f8")), "tree")
    assert tree["a"].dtype == np.float64 and tree["a"].dtype.isnative and np.array_equal(tree["a"], TREE["a"])
    assert jnp.asarray(tree["a"]).shape == (2, 3)


@pytest.mark.parametrize(("changes", "words"), [
    ({"a": np.array(["x", "y"])}, ("a", "an array of numbers", "<U1")),
    ({"a": np.zeros(2, "M8[s]")}, ("a", "an array of numbers", "datetime64")),
    ({"b__c": np.zeros(3)}, ()),
    ({"b": np.zeros(3)}, ("both named 'b'",)),
])
def test_other_things_than_numbers_are_refused(file, changes, words):
    doctored(file, **changes)
    if words:
        with pytest.raises(mo.FileError) as error:
            read_tree(file, "tree")
        refused(error, "tree.npz", *words)
    else:
        read_tree(file, "tree")


@pytest.mark.parametrize("content", [b"[]", b"{}", b"null", b"{" * 9999, b"\xff",
                                     b'{"kind": "tree", "format": 1, "texts": [], "crc32": {}}'])
def test_headers_of_another_form_are_refused(tmp_path, content):
    with zipfile.ZipFile(tmp_path / "t.npz", "w") as made:
        made.writestr("header.json", content)
    with pytest.raises(mo.FileError) as error:
        read_tree(tmp_path / "t.npz", "tree")
    refused(error, "t.npz", "header")


def claim(path, text, size=None, name="a"):
    """Give an array a header of its own words; the member holds nothing else."""
    with zipfile.ZipFile(path) as old:
        content = {member: old.read(member) for member in old.namelist()}
    head = text.encode().ljust(117) + b"\n"
    content[f"{name}.npy"] = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + bytes(size or 0)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for member, data in content.items():
            new.writestr(member, data)


@pytest.mark.parametrize("shape", ["(90000, 90000)", "(-1, -1)", "(3,)", "(10**9, 10**9)", "2"])
def test_headers_that_lie_are_refused_before_memory_is_taken(file, shape):
    claim(file, f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}")
    tracemalloc.start()
    with pytest.raises(mo.FileError) as error:
        read_tree(file, "tree")
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    refused(error, "tree.npz")


def test_members_that_come_twice_are_refused(file, tmp_path):
    for path, name in ((file, "a.npy"), (tmp_path / "map.npz", "elevation.npy")):
        if not path.exists():
            np.savez(path, elevation=np.ones((3, 3), np.int16), xmin=5, xmax=5.003, ymin=45, ymax=44.997, dx=0.001, dy=0.001)
        with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(path, "a") as again:
            again.writestr(name, again.read(name))
        with pytest.raises(mo.FileError) as error:
            read_tree(path, "tree") if path is file else read_raster(path)
        refused(error, path.name, "more than once", name)


def test_a_trap_is_refused_before_it_is_unpacked_and_what_we_write_never_is_one(tmp_path, monkeypatch):
    monkeypatch.setattr(members, "LARGEST", 100_000)
    zeros = {"a": np.zeros(200_000)}
    path = write_tree(tmp_path / "own.npz", zeros, {}, "tree")
    assert np.array_equal(read_tree(path, "tree")[0]["a"], zeros["a"])
    doctored(path, a=np.zeros(200_000))
    with pytest.raises(mo.FileError) as error:
        read_tree(path, "tree")
    refused(error, "own.npz", "unpacked")


def test_what_headers_say_is_asked_before_arrays_are_read(file, monkeypatch):
    def never(*_):
        raise AssertionError("read")

    monkeypatch.setattr(members.Members, "read", never)
    for wanted, words in (
        ({"a": ((2, 4), "f")}, ("tree.npz: a", "real numbers of shape (2, 4)", "float64[2, 3]")),
        ({"a": ((2,), "f")}, ("shape (2)",)),
        ({"a": ((None, None), "iu")}, ("whole numbers of shape (any, any)",)),
        ({"a": ((2, 3), "f"), "b/x": ((), "f")}, ("b/x", "nothing")),
        ({"b": ((), "f")}, ("tree.npz: b", "a folder")),
        ({"b/c": ((3, ...), "b")}, ("true or false of shape (3, ...)", "bool[2]")),
    ):
        with pytest.raises(mo.FileError) as error:
            read_tree(file, "tree", lambda forms, texts, wanted=wanted: agree(file, forms, wanted))
        refused(error, *words)
    forms = {}
    with contextlib.suppress(mo.FileError):
        read_tree(file, "tree", lambda found, texts: forms.update(found))
    agree(file, forms, {"a": ((2, ...), "f"), "b/c": ((None,), "b"), "b/d": ((...,), "iu")})


def test_one_part_repeats_another():
    tree = {"many": {"x": np.zeros((7, 2, 3))}, "one": {"x": np.zeros((2, 3))}, "else": {"x": np.zeros((2, 3)), "y": np.zeros(1)}}
    repeats("f", tree, "many", (7,), "one", ())
    repeats("f", tree, "many/x", (7,), "one/x", ())
    for arguments in (("many", (6,), "one", ()), ("many", (7,), "else", ()), ("else", (), "one", ()), ("many", (7, 2), "one", ())):
        with pytest.raises(mo.FileError):
            repeats("f", tree, *arguments)


# chains --------------------------------------------------------------------------------------------------------------


def log_density(x):
    return -0.5 * jnp.sum(x["p"] ** 2)


@pytest.fixture(scope="module")
def chains():
    return mo.sample(0, mcmc.RandomWalkMetropolis(1.0), log_density, {"p": jnp.zeros(2)}, draws=6, chains=3)


DOCTORED = {
    "huge positions": {"positions__p": np.zeros((3, 6, 250_000), np.float32)},
    "huge log density": {"log_density": np.zeros((3, 900_000), np.float32)},
    "text positions": {"positions__p": np.full((3, 6, 2), "1")},
    "text counts": {"info__tried": np.full((3, 1), "1")},
    "counts of another number of moves": {"info__accepted": np.zeros((3, 2), np.float32)},
    "no counts": {"info__invalid": None},
    "no positions": {"positions__p": None},
    "no end": {"last__position__p": None},
    "scalar log density": {"log_density": np.float32(1)},
    "NaN log density": {"log_density": np.full((3, 6), np.nan, np.float32)},
    "steps that are no number": {"steps": np.zeros(3)},
}


@pytest.mark.parametrize("name", DOCTORED)
def test_chains_that_are_none_are_refused(chains, tmp_path, name):
    path = doctored(chains.save(tmp_path / "chains.npz"), **DOCTORED[name])
    for arguments in ((), (mcmc.RandomWalkMetropolis(1.0), log_density, {"p": jnp.zeros(2)})):
        with pytest.raises(mo.FileError) as error:
            mo.Chains.load(path, *arguments)
        refused(error, "chains.npz")


def test_chains_of_another_byte_order_go_on(chains, tmp_path):
    kernel, path = mcmc.RandomWalkMetropolis(1.0), chains.save(tmp_path / "chains.npz")
    wanted = mo.sample(0, kernel, log_density, chains, draws=3)
    parts = {"positions__p": chains.positions["p"], "log_density": chains.log_density, "last__position__p": chains.last.position["p"]}
    turned = {name: np.asarray(value).astype(value.dtype.newbyteorder(">")) for name, value in parts.items()}
    again = mo.sample(0, kernel, log_density, mo.Chains.load(doctored(path, **turned), kernel, log_density), draws=3)
    assert np.array_equal(again.positions["p"], wanted.positions["p"])


def test_mutated_chains_are_read_or_refused(chains, tmp_path):
    path = chains.save(tmp_path / "chains.npz")
    good, draw, read = path.read_bytes(), np.random.default_rng(3), 0
    for _ in range(200):
        data = np.frombuffer(good, np.uint8).copy()
        data[draw.integers(len(data), size=draw.integers(1, 5))] = draw.integers(256)
        path.write_bytes(data.tobytes()[: len(data) if draw.random() < 0.8 else int(draw.integers(1, len(data)))])
        with contextlib.suppress(mo.FileError):
            assert jax.tree.all(jax.tree.map(np.array_equal, mo.Chains.load(path).positions, chains.positions))
            read += 1
    assert read < 100
